import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    JointDrivePropertiesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import HOPPER_MJCF, scene_of, start, touching, write

ARM = """<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    {extra}
    <body name="base" pos="{pos}" quat="0.9238795325112867 0 0 0.3826834323650898">
      <geom type="box" size="0.1 0.1 0.1" mass="3"/>
      <body name="upper" pos="0 0 0.3">
        <joint name="a" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.04" mass="1"/>
        <body name="lower" pos="0.4 0 0">
          <joint name="b" axis="0.6 0 0.8" damping="0.02"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04" mass="0.5"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"""


@pytest.mark.parametrize("ground", [False, True])
def test_a_mocap_base_moves_the_arm_exactly_as_a_fixed_body_does(tmp_path, ground):
    # Low enough that, with the ground, the arm falls onto it.
    xml = ARM.format(pos="0.3 0 0.2", extra='<geom type="plane" size="0 0 1"/>' if ground else "")
    fixed = mujoco.MjModel.from_xml_string(xml)
    cfg = RobotCfg(
        fpath=write(tmp_path / "arm.xml", ARM.format(pos="0.3 0 0.2", extra="")),
        drive_pros=JointDrivePropertiesCfg(drive_type="none"),
    )
    sim = SimulationManagerCfg(physics_dt=0.005, ground_plane=ground)
    scene = scene_of({"arm": cfg}, sim=sim)
    assert scene.entities["arm"].mocap_id == 0
    fixed_data = mujoco.MjData(fixed)
    data = start(scene, {"arm": [0.0, 0.0]})
    contacts = 0
    for _ in range(400):
        mujoco.mj_step(fixed, fixed_data)
        mujoco.mj_step(scene.model, data)
        contacts += data.ncon
        assert np.abs(data.qpos - fixed_data.qpos).max() < 1e-12
    assert contacts > 0  # with the ground, or with its own base
    assert np.abs(data.qpos).max() > 0.1


def test_a_fixed_base_stops_what_falls_on_it_and_ignores_what_stands_still(tmp_path):
    cfg = RobotCfg(fpath=write(tmp_path / "arm.xml", ARM.format(pos="0 0 0", extra="")))
    objects = {
        "table": RigidObjectCfg(shape=CubeCfg(size=[1, 1, 0.2]), body_type="static"),
        "marker": RigidObjectCfg(shape=CubeCfg(size=[0.1] * 3), body_type="kinematic"),
        "ball": RigidObjectCfg(shape=SphereCfg(radius=0.05), init_pos=(-0.08, 0, 0.4)),
    }
    scene = scene_of({"arm": cfg}, objects)
    data = start(scene, {})
    # The base stands in the table, the ground and the marker; none of them can move.
    assert touching(scene, data) == set()
    seen = set()
    for _ in range(60):
        mujoco.mj_step(scene.model, data)
        seen |= touching(scene, data)
    assert frozenset({"ball", "arm/base"}) in seen


def test_the_base_moves_with_its_mocap_pose(tmp_path):
    cfg = RobotCfg(fpath=write(tmp_path / "arm.xml", ARM.format(pos="0 0 0", extra="")))
    scene = scene_of({"arm": cfg})
    data = start(scene, {})
    data.mocap_pos[0] = [1, 2, 3]
    mujoco.mj_forward(scene.model, data)
    root = scene.entities["arm"].root_body_id
    assert data.xpos[root].tolist() == [1, 2, 3]


def test_a_pose_in_the_config_places_the_files_world(tmp_path):
    name = write(tmp_path / "arm.xml", ARM.format(pos="0.3 0 0.2", extra=""))
    cfg = RobotCfg(fpath=name, init_pos=(1, 0, 0), init_rot=(0, 0, 90))
    index = scene_of({"arm": cfg}).entities["arm"]
    np.testing.assert_allclose(index.pos0, [1, 0.3, 0.2], atol=1e-12)
    angle = np.pi / 2 + np.pi / 4
    np.testing.assert_allclose(
        index.quat0, [np.cos(angle / 2), 0, 0, np.sin(angle / 2)], atol=1e-12
    )


def test_a_floating_base_starts_at_the_keyframe_and_falls(tmp_path):
    cfg = RobotCfg(
        fpath=write(tmp_path / "hopper.xml", HOPPER_MJCF), fix_base=False, init_pos=(2, 0, 1)
    )
    parsed = parse_articulation("h", cfg)
    assert not parsed.fixed_base and parsed.joint_names == ("hip",)
    scene = scene_of({"h": cfg})
    index = scene.entities["h"]
    assert (index.mocap_id, index.free_qpos_adr, index.free_qvel_adr) == (-1, 0, 0)
    assert index.pos0.tolist() == [2, 0, 1]
    data = start(scene, {"h": parsed.init_qpos})
    for _ in range(10):
        mujoco.mj_step(scene.model, data)
    assert data.qpos[2] < 0.99


def test_fix_base_decides_even_if_the_file_floats(tmp_path):
    cfg = RobotCfg(fpath=write(tmp_path / "hopper.xml", HOPPER_MJCF))
    scene = scene_of({"h": cfg})
    assert scene.model.nq == 1 and scene.entities["h"].mocap_id == 0


def test_a_root_that_moves_on_joints_hangs_on_a_body_of_its_own(tmp_path):
    cart = """<mujoco><worldbody><geom name="rail" type="box" size="1 .02 .02"/>
      <body name="cart" pos="0 0 1"><joint name="slide" type="slide" axis="1 0 0"/>
      <geom size=".1"/><body name="pole"><joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .5" size=".02"/></body></body></worldbody></mujoco>"""
    cfg = RobotCfg(fpath=write(tmp_path / "cart.xml", cart), init_pos=(0, 1, 0))
    parsed = parse_articulation("c", cfg)
    assert parsed.link_names == ("root", "cart", "pole")
    assert parsed.joint_names == ("slide", "hinge")
    scene = scene_of({"c": cfg})
    assert scene.entities["c"].mocap_id == 0
    data = start(scene, {})
    assert data.body("c/cart").xpos.tolist() == [0, 1, 1]
    assert scene.model.geom("c/rail").bodyid[0] == scene.entities["c"].root_body_id


def test_several_free_bodies_are_no_articulation(tmp_path):
    two = "<mujoco><worldbody>" + 2 * '<body><freejoint/><geom size=".1"/></body>'
    name = write(tmp_path / "two.xml", two + "</worldbody></mujoco>")
    with pytest.raises(ConfigError, match="one articulation is one tree"):
        parse_articulation("two", RobotCfg(fpath=name))
