"""Joints that are fixed: poses of links against the unlocked robot's, what is left, mistakes."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import RobotCfg
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import GRIPPER_URDF, HOME, HOPPER_MJCF, UR10, write


def parsed(path, locked, **fields):
    return parse_articulation("arm", RobotCfg(fpath=path, locked_joints=locked, **fields))


def poses(arm, qpos):
    """Position and orientation of each link with joints at some positions."""
    data = mujoco.MjData(arm.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(arm.model, data)
    return {name: data.body(name).xpos for name in arm.link_names}, data.body("ee_link").xmat


def test_links_are_where_the_locked_joints_put_them_and_the_others_move():
    at = {"Joint2": HOME[1], "Joint[45]": -1.2}
    arm, whole = parsed(UR10, at), parsed(UR10, {})
    assert arm.joint_names == ("Joint1", "Joint3", "Joint6")
    assert arm.drives == ("Joint1", "Joint3", "Joint6")
    assert arm.link_names == whole.link_names and arm.model.nv == 3
    np.testing.assert_array_equal(arm.model.body_mass, whole.model.body_mass)
    for first, third, last in ((0, 0, 0), (0.3, -0.8, 2.0)):
        found, tool = poses(arm, [first, third, last])
        wanted, there = poses(whole, [first, HOME[1], third, -1.2, -1.2, last])
        np.testing.assert_allclose(tool, there, atol=1e-9)
        for name in wanted:
            np.testing.assert_allclose(found[name], wanted[name], atol=1e-9)


def test_a_slide_is_locked_along_its_axis(tmp_path):
    text = GRIPPER_URDF.replace('<mimic joint="slide_left" multiplier="-2" offset="0.1"/>', "")
    arm = parsed(write(tmp_path / "free.urdf", text), {"slide_left": 0.2})
    assert arm.joint_names == ("slide_right",)
    # 0.1 m from the base in the file, moved by 0.2 m.
    np.testing.assert_allclose(arm.model.body("left").pos, [0.3, 0, 0], atol=1e-12)


def test_every_mistake_is_reported_at_its_place(tmp_path):
    with pytest.raises(ConfigError) as caught:
        parsed(UR10, {"Jiont1": 0, "Joint3": 9, "Joint[34]": 0})
    found = {p.path: f"{p.message} {p.hint}" for p in caught.value.problems}
    below = "arm.locked_joints"
    assert set(found) == {f"{below}.Jiont1", f"{below}.Joint3", f"{below}.Joint[34]"}
    assert "Did you mean 'Joint1'?" in found[f"{below}.Jiont1"]
    assert "9 is outside the limits of joint 'Joint3', [-3.14" in found[f"{below}.Joint3"]
    assert "another entry matches joint 'Joint3' too" in found[f"{below}.Joint[34]"]
    gripper = write(tmp_path / "gripper.urdf", GRIPPER_URDF)
    for name in ("slide_left", "slide_right"):
        with pytest.raises(ConfigError, match=r"follows or leads another \(mimic\)"):
            parsed(gripper, {name: 0})
    with pytest.raises(ConfigError, match="locked_joints: joints of an MJCF cannot be locked"):
        parsed(write(tmp_path / "hopper.xml", HOPPER_MJCF), {"hip": 0})
    # What is locked is no joint for the rest of the config.
    with pytest.raises(ConfigError, match=r"init_qpos.Joint2: no joint matches 'Joint2'"):
        parsed(UR10, {"Joint2": 0}, init_qpos={"Joint2": 0})
