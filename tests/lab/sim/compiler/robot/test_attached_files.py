"""Files attached to a robot: nothing of them is lost, and they are part of the robot's handle."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import AttachedFileCfg, JointDrivePropertiesCfg, RobotCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.utils.errors import ConfigError
from tests.helpers.mjcf_robots import HAND, UR5E, UR5E_HOME
from tests.lab.sim.compiler.helpers import GRIPPER_URDF, HOPPER_MJCF, UR10, scene_of, write

KINDS = ("actuator", "tendon", "eq", "jnt", "dof")
VALUES = {
    "actuator": ("gainprm", "biasprm", "forcerange", "ctrlrange", "gear", "trntype"),
    "tendon": ("range", "stiffness", "damping"),
    "eq": ("type", "data", "solref", "solimp", "active0"),
    "jnt": ("type", "axis", "range", "stiffness", "pos"),
    "dof": ("damping", "armature", "frictionloss"),
}
EXTRAS = """<contact><exclude name="apart" body1="right_driver" body2="left_driver"/></contact>
<sensor><actuatorfrc name="grip" actuator="fingers"/><jointpos joint="right_driver_joint"/></sensor>
<keyframe><key name="home" qpos="0.4 0 0 0 0.4 0 0 0" ctrl="100"/></keyframe>
</mujoco>"""


@pytest.fixture
def hand(tmp_path):
    text = HAND.replace("<worldbody>", '<option impratio="10"/><worldbody>')
    return write(tmp_path / "hand.xml", text.replace("</mujoco>", EXTRAS))


def parsed(fpath, attach, **cfg):
    return parse_articulation("arm", RobotCfg(fpath=fpath, attach=attach, **cfg))


def rows(model, kind, prefix=""):
    """Rows whose element (a joint for dofs and equalities) has the prefix."""
    if kind == "dof":
        return [j for j in range(model.njnt) if model.joint(j).name.startswith(prefix)]
    if kind == "eq":
        names = [model.joint if t == 2 else model.body for t in model.eq_type]
        ids = [name(i).name for name, i in zip(names, model.eq_obj1id, strict=True)]
        return [i for i, name in enumerate(ids) if name.startswith(prefix)]
    name, count = {
        "jnt": (model.joint, model.njnt),
        "actuator": (model.actuator, model.nactuator),
        "tendon": (model.tendon, model.ntendon),
    }[kind]
    return [i for i in range(count) if name(i).name.startswith(prefix)]


def test_two_hands_on_one_arm_keep_everything_of_their_file(hand):
    arm = parsed(
        UR10,
        {
            "left": AttachedFileCfg(fpath=hand, to="ee_link", pos=(0, 0.1, 0)),
            "right": AttachedFileCfg(fpath=hand, to="wrist_3_link", rot=(90, 0, 0)),
        },
    )
    alone = mujoco.MjModel.from_xml_path(hand)
    for prefix in ("left/", "right/"):
        for kind in KINDS:
            mine = rows(arm.model, kind, prefix)
            assert len(mine) == len(rows(alone, kind)) > 0, kind
            for value in VALUES[kind]:
                found = getattr(arm.model, f"{kind}_{value}")[mine]
                wanted = getattr(alone, f"{kind}_{value}")[rows(alone, kind)]
                if (kind, value) == ("eq", "data"):  # of connects, derived from the pose at qpos0
                    found, wanted = found[:, :3], wanted[:, :3]
                np.testing.assert_allclose(found, wanted, atol=1e-12, err_msg=value)
        assert {f"{prefix}base", f"{prefix}left_follower"} <= set(arm.link_names)
        assert (
            arm.model.sensor(f"{prefix}grip").objid[0] == arm.model.actuator(f"{prefix}fingers").id
        )
        assert arm.model.exclude(f"{prefix}apart").id >= 0
    assert arm.model.nsensor == 4
    bodies = [arm.model.body(f"{name}/base") for name in ("left", "right")]
    assert [arm.model.body(b.parentid[0]).name for b in bodies] == ["ee_link", "wrist_3_link"]
    np.testing.assert_allclose(bodies[0].pos, [0, 0.1, 0])
    np.testing.assert_allclose(bodies[1].quat, [2**-0.5, 2**-0.5, 0, 0], atol=1e-12)


def test_joints_and_actuators_belong_to_the_robot(hand):
    bare = parse_articulation("arm", RobotCfg(fpath=UR10))
    attach = {"hand": AttachedFileCfg(fpath=hand, to="ee_link")}
    arm = parsed(UR10, attach, control_parts={"fingers": ["hand/.*_driver_joint"]})
    assert arm.joint_names[:6] == bare.joint_names
    assert len(arm.joint_names) == 6 + 8
    assert arm.control_names == ("hand/fingers", *bare.control_names)
    assert arm.driven.tolist() == [True] * 6 + [False] * 8
    np.testing.assert_array_equal(arm.stiffness[:6], bare.stiffness)
    assert [arm.joint_names[i] for i in arm.control_parts["fingers"]] == [
        "hand/right_driver_joint",
        "hand/left_driver_joint",
    ]
    drivers = list(arm.control_parts["fingers"])
    np.testing.assert_allclose(arm.init_qpos[drivers], 0.4)  # the hand's keyframe
    np.testing.assert_allclose(arm.init_qpos[:6], bare.init_qpos)
    assert arm.init_ctrl[0] == 100
    qpos = parsed(UR10, attach, init_qpos={"Joint2": -1, "hand/right_driver_joint": 0.2}).init_qpos
    assert (qpos[1], qpos[6]) == (-1, 0.2)


def test_a_list_of_initial_positions_may_leave_out_attached_joints(hand):
    attach = {"hand": AttachedFileCfg(fpath=hand, to="ee_link")}
    own = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
    qpos = parsed(UR10, attach, init_qpos=own).init_qpos
    np.testing.assert_allclose(qpos[:6], own)
    assert qpos[6] == pytest.approx(0.4)  # the hand's keyframe
    np.testing.assert_allclose(parsed(UR10, attach, init_qpos=[*own, *[0.0] * 8]).init_qpos[6:], 0)
    with pytest.raises(ConfigError, match="14 values"):
        parsed(UR10, attach, init_qpos=own[:3])


def test_names_of_a_wrong_attachment_are_not_reported_too(hand):
    attach = {"hand": AttachedFileCfg(fpath=hand, to="eelink")}
    with pytest.raises(ConfigError) as caught:
        parsed(UR10, attach, control_parts={"hand": ["hand/.*"]})
    assert [p.path for p in caught.value.problems] == ["arm.attach.hand.to"]


def test_drives_of_a_urdf_gripper_on_an_mjcf_arm(tmp_path):
    arm_file, gripper = write(tmp_path / "a.xml", UR5E), write(tmp_path / "g.urdf", GRIPPER_URDF)
    attach = {"gripper": AttachedFileCfg(fpath=gripper, to="wrist_3_link")}
    arm = parsed(arm_file, attach)
    assert arm.joint_names[6:] == ("gripper/slide_left", "gripper/slide_right")
    assert arm.driven.tolist() == [False] * 6 + [True, False]
    assert (arm.mimic_ids, arm.mimic_parents, arm.mimic_multipliers) == ((7,), (6,), (-2.0,))
    assert arm.stiffness[0] == 2000  # its file's servo
    assert (arm.stiffness[6], arm.damping[6]) == (1e4, 1e3)  # EmbodiChain's, as for every URDF
    assert np.isinf(arm.max_effort[6])
    assert arm.qvel_limits[6] == 0.3
    np.testing.assert_allclose(arm.init_qpos[:6], UR5E_HOME, atol=1e-6)
    assert arm.init_qpos[7] == pytest.approx(0.1)  # follows at -2 x 0 + 0.1
    drives = JointDrivePropertiesCfg(stiffness={"gripper/.*left": 300}, max_effort="file")
    arm = parsed(arm_file, attach, drive_pros=drives)
    assert (arm.stiffness[6], arm.max_effort[6]) == (300, 20)
    assert not arm.driven[:6].any()


def test_single_numbers_of_drive_pros_leave_an_attached_mjcf_alone(tmp_path):
    jaw = write(tmp_path / "jaw.xml", HOPPER_MJCF)
    attach = {"jaw": AttachedFileCfg(fpath=jaw, to="ee_link")}
    drives = JointDrivePropertiesCfg(stiffness=500, damping=50, armature=0.3, max_effort=70)
    arm = parsed(UR10, attach, drive_pros=drives)
    assert arm.joint_names[6:] == ("jaw/hip",)
    np.testing.assert_array_equal(arm.stiffness, [500] * 6 + [30])
    np.testing.assert_array_equal(arm.max_effort, [70] * 6 + [np.inf])
    np.testing.assert_allclose(arm.armature, [0.3] * 6 + [0.02])
    assert {"jaw/spare", "jaw/servo"} <= set(arm.control_names)
    named = JointDrivePropertiesCfg(stiffness={"jaw/.*": 90})
    arm = parsed(UR10, attach, drive_pros=named)
    assert (arm.stiffness[6], arm.damping[6]) == (90, 2)  # the damping is its servo's
    assert "jaw/servo" not in arm.control_names
    assert any("free body 'torso' is fixed" in note for note in arm.notes)


def test_options_without_effect_are_reported_for_each_file(hand, caplog):
    attach = {n: AttachedFileCfg(fpath=hand, to="ee_link") for n in ("one", "two")}
    scene_of({"arm": RobotCfg(fpath=UR10, attach=attach)})
    said = [r.getMessage() for r in caplog.records if "options" in r.getMessage()]
    assert [
        f"(attach.{n}): the scene's physics replaces its options: impratio 10 -> 1" in text
        for n, text in zip(attach, said, strict=True)
    ] == [True, True]


def test_a_hand_on_a_tool_changer(tmp_path, hand):
    plate = write(
        tmp_path / "plate.xml",
        '<mujoco><worldbody><body name="plate"><geom size=".02"/><camera name="eye"/></body>'
        "</worldbody></mujoco>",
    )
    attach = {
        "changer": AttachedFileCfg(fpath=plate, to="ee_link"),
        "hand": AttachedFileCfg(fpath=hand, to="changer/plate"),
    }
    scene = scene_of({"arm": RobotCfg(fpath=UR10, attach=attach)})
    hand_body = scene.model.body("arm/hand/base")
    assert scene.model.body(hand_body.parentid[0]).name == "arm/changer/plate"
    assert scene.model.camera("arm/changer/eye").id >= 0


def test_every_mistake_is_reported_at_its_key(tmp_path, hand):
    broken = write(
        tmp_path / "broken.xml",
        '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
    )
    meshless = GRIPPER_URDF.replace('<box size="0.1 0.1 0.1"/>', '<mesh filename="lost.stl"/>', 1)
    with pytest.raises(ConfigError) as caught:
        parsed(
            UR10,
            {
                "a": AttachedFileCfg(fpath=hand, to="eelink"),
                "b": AttachedFileCfg(fpath=broken, to="ee_link"),
                "c": AttachedFileCfg(fpath=write(tmp_path / "c.urdf", meshless), to="ee_link"),
                "d/e": AttachedFileCfg(fpath=hand, to="ee_link", pos=(0, float("nan"), 0)),
                "f": AttachedFileCfg(fpath="no/such.xml", quat=(0, 0, 0, 0)),
            },
        )
    found = {p.path: f"{p.message} {p.hint}" for p in caught.value.problems}
    paths = "a.to", "b.fpath", "c.fpath", "d/e", "d/e.pos", "f.to", "f.fpath", "f.quat"
    assert set(found) == {f"arm.attach.{path}" for path in paths}
    assert "ee_link" in found["arm.attach.a.to"]
    where = f"{broken}:1: mesh 'm': no file 'gone.stl' in {tmp_path}; there are: "
    assert found["arm.attach.b.fpath"].startswith(where)
    assert "collision mesh of link 'left'" in found["arm.attach.c.fpath"]
    assert "lost.stl" in found["arm.attach.c.fpath"]
