"""Shapes fixed on links: they are links, they weigh, they collide, and mistakes are reported."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import AttachmentCfg, RobotCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.shapes import CylinderCfg, PlaneCfg
from embodichain.utils.errors import ConfigError

UR10 = "UniversalRobots/UR10/UR10.urdf"


def parsed(**attachments):
    return parse_articulation("arm", RobotCfg(fpath=UR10, attachments=attachments))


def test_an_attachment_is_a_link_with_mass_and_a_colliding_shape():
    bare = parsed()
    tool = AttachmentCfg(
        link="ee_link", shape=CylinderCfg(radius=0.02, height=0.1), init_pos=(0, 0, 0.05), mass=0.3
    )
    arm = parsed(tool=tool)
    assert set(arm.link_names) - set(bare.link_names) == {"tool"}
    body = arm.model.body("tool")
    assert arm.model.body(body.parentid[0]).name == "ee_link"
    np.testing.assert_allclose(body.pos, [0, 0, 0.05])
    assert body.mass[0] == pytest.approx(0.3)
    geom = arm.model.geom("tool/geom")
    np.testing.assert_allclose(geom.size[:2], [0.02, 0.05])
    assert geom.contype[0]
    assert arm.model.body_mass.sum() == pytest.approx(bare.model.body_mass.sum() + 0.3)


def test_an_attachment_may_be_there_for_people_only():
    arm = parsed(tool=AttachmentCfg(link="ee_link", enable_collision=False))
    assert not arm.model.geom("tool/geom").contype[0]


def test_every_mistake_is_reported_at_its_place():
    with pytest.raises(ConfigError) as caught:
        parsed(
            ee_link=AttachmentCfg(link="ee_link"),
            tool=AttachmentCfg(link="eelink", shape=CylinderCfg()),
            floor=AttachmentCfg(link="ee_link", shape=PlaneCfg()),
        )
    found = {p.path: f"{p.message} {p.hint}" for p in caught.value.problems}
    assert set(found) == {
        "arm.attachments.ee_link",
        "arm.attachments.tool.link",
        "arm.attachments.floor.shape",
    }
    assert "ee_link" in found["arm.attachments.tool.link"]


def test_gravity_compensation_holds_an_arm_without_drives():
    from embodichain.lab.sim.cfg import JointDrivePropertiesCfg

    def sag(gravcomp):
        drives = JointDrivePropertiesCfg(drive_type="none")
        cfg = RobotCfg(fpath=UR10, drive_pros=drives, gravcomp=gravcomp)
        model = parse_articulation("arm", cfg).model
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 100)
        return np.abs(data.qpos).max()

    assert sag(1.0) < 1e-9
    assert sag(None) > 0.1
