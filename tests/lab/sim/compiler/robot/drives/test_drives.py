import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    JointDrivePropertiesCfg,
    PhysicsCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import GRIPPER_URDF, HOME, UR10, scene_of, start, write


def ur10(**drives):
    return RobotCfg(
        fpath=UR10,
        init_pos=(0, 0, 1),
        init_qpos=HOME,
        drive_pros=JointDrivePropertiesCfg(**drives),
    )


@pytest.mark.parametrize("physics_dt", [0.01, 0.005])
@pytest.mark.parametrize("max_effort", [1e10, "file"])
def test_the_tutorials_actions_keep_the_arm_slow_and_near_home(physics_dt, max_effort):
    scene = scene_of(
        {"ur10": ur10(max_effort=max_effort)}, sim=SimulationManagerCfg(physics_dt=physics_dt)
    )
    data = start(scene, {"ur10": HOME})
    random = np.random.default_rng(0)
    fastest = farthest = 0.0
    for _ in range(300):
        data.ctrl[:] = np.asarray(HOME) + random.uniform(-0.1, 0.1, 6)
        for _ in range(4):
            mujoco.mj_step(scene.model, data)
            fastest = max(fastest, np.abs(data.qvel).max())
            farthest = max(farthest, np.abs(data.qpos - HOME).max())
    assert 0.01 < fastest < 3.0
    assert 0.01 < farthest < 0.2
    assert not any(w.number for w in data.warning)


def test_a_limited_joint_accelerates_at_effort_by_inertia_and_passes_effort_by_damping():
    # The wrist of a Panda as lift_cube drives it: damping in the joint held it to 12 / 40 rad/s.
    scene = scene_of(
        {"ur10": ur10(stiffness=400, damping=40, max_effort=12, armature=0.1)},
        sim=SimulationManagerCfg(
            physics_dt=0.005, physics_config=PhysicsCfg(gravity=(0, 0, 0)), ground_plane=False
        ),
    )
    model, data = scene.model, start(scene, {"ur10": HOME})
    data.ctrl[5] += 1.0
    inertia = model.dof_M0[5]  # the last joint's does not depend on the posture
    mujoco.mj_step(model, data)
    assert data.qvel[5] == pytest.approx(0.005 * 12 / inertia, rel=1e-3)
    speeds, places = [data.qvel[5]], [data.qpos[5] - HOME[5]]
    for _ in range(400):
        mujoco.mj_step(model, data)
        speeds.append(data.qvel[5])
        places.append(data.qpos[5] - HOME[5])
    assert max(speeds) > 10 * 12 / 40
    assert np.argmax(np.array(places) > 0.9) * 0.005 < 0.3
    assert max(places) < 1.001
    assert abs(speeds[-1]) < 1e-6


def test_the_files_damping_stays_in_the_joint_beside_the_drive(tmp_path):
    cfg = RobotCfg(fpath=write(tmp_path / "g.urdf", GRIPPER_URDF))
    model = scene_of({"g": cfg}).model
    left = model.joint("g/slide_left").dofadr[0]
    assert model.dof_damping[left] == 0.4
    # the joint that mimics it, at -2 times its speed, carries a part
    right = model.dof_damping[model.joint("g/slide_right").dofadr[0]]
    assert model.actuator("g/slide_left").biasprm[2] == pytest.approx(-1000 + 4 * right)


def test_efforts_are_unlimited_by_default_and_the_files_on_request():
    default = parse_articulation("a", RobotCfg(fpath=UR10))
    assert np.isinf(default.max_effort).all()
    assert default.qf_limits.tolist() == [330, 330, 150, 56, 56, 56]
    free = scene_of({"a": RobotCfg(fpath=UR10)}).model
    assert not free.actuator_forcelimited.any() and not free.jnt_actfrclimited.any()
    limited = scene_of({"a": ur10(max_effort="file")}).model
    assert limited.actuator_forcerange[:, 1].tolist() == [330, 330, 150, 56, 56, 56]


def test_stiffness_and_damping_are_in_the_actuator():
    model = scene_of({"a": ur10(stiffness=500, damping=50, friction=2, armature=0.1)}).model
    assert (model.actuator_gainprm[:, 0] == 500).all()
    assert (model.actuator_biasprm[:, :3] == [0, -500, -50]).all()
    assert not model.dof_damping.any()  # the file gives none
    assert (model.dof_frictionloss == 2).all()
    assert (model.dof_armature == 0.1).all()
    assert not model.actuator_ctrllimited.any()


def test_a_map_sets_joints_by_regex_and_control_parts_last():
    cfg = ur10(stiffness={"wrist": 7.0, "Joint[1-5]": 5.0})
    cfg.control_parts = {"wrist": ["Joint[56]"]}
    parsed = parse_articulation("a", cfg)
    assert parsed.stiffness.tolist() == [5, 5, 5, 5, 7, 7]
    assert parsed.control_parts == {"wrist": (4, 5)}


def test_a_drive_by_acceleration_scales_with_the_joints_inertia():
    parsed = parse_articulation("a", ur10(drive_type="acceleration", stiffness=100, damping=10))
    model = scene_of({"a": RobotCfg(fpath=UR10)}).model
    np.testing.assert_allclose(parsed.stiffness, 100 * model.dof_M0, rtol=1e-9)
    np.testing.assert_allclose(parsed.damping, 10 * model.dof_M0, rtol=1e-9)


def test_without_drives_joints_keep_the_files_damping_and_friction(tmp_path):
    cfg = RobotCfg(
        fpath=write(tmp_path / "g.urdf", GRIPPER_URDF),
        drive_pros=JointDrivePropertiesCfg(drive_type="none"),
    )
    parsed = parse_articulation("g", cfg)
    assert parsed.damping.tolist() == [0.4, 0.0]
    assert parsed.friction.tolist() == [0.2, 0.0]
    assert scene_of({"g": cfg}).entities["g"].actuator_ids.tolist() == [-1, -1]


def test_a_mimic_joint_follows_and_has_no_drive_of_its_own(tmp_path):
    cfg = RobotCfg(
        fpath=write(tmp_path / "g.urdf", GRIPPER_URDF),
        init_pos=(0, 0, 1),
        init_qpos={"slide_left": 0.05},
    )
    parsed = parse_articulation("g", cfg)
    assert (parsed.mimic_ids, parsed.mimic_parents) == ((1,), (0,))
    assert (parsed.mimic_multipliers, parsed.mimic_offsets) == ((-2.0,), (0.1,))
    np.testing.assert_allclose(parsed.init_qpos, [0.05, 0.0], atol=1e-12)
    scene = scene_of({"g": cfg})
    index = scene.entities["g"]
    assert index.actuator_ids.tolist() == [0, -1]
    data = start(scene, {"g": parsed.init_qpos})
    data.ctrl[0] = 0.2
    for _ in range(400):
        mujoco.mj_step(scene.model, data)
    left, right = data.qpos[index.qpos_adr]
    assert left == pytest.approx(0.2, abs=5e-3)
    assert right == pytest.approx(-2 * left + 0.1, abs=5e-3)


@pytest.mark.parametrize(
    ("drives", "message"),
    [
        (
            {"stiffness": {"Joint7": 1.0}},
            "a.drive_pros.stiffness.Joint7: no joint matches 'Joint7'; there are: Joint1, Joint2, "
            "Joint3, Joint4, Joint5, Joint6 Did you mean 'Joint1'?",
        ),
        ({"damping": -1.0}, "a.drive_pros.damping: must not be negative, got -1.0"),
        (
            {"armature": {"Joint1": -0.5}},
            "a.drive_pros.armature.Joint1: must not be negative, got -0.5",
        ),
        (
            {"max_effort": {"Joint[12]": 0.0}},
            "a.drive_pros.max_effort: must be positive; a joint that shall not push needs "
            "stiffness 0 instead",
        ),
        ({"max_velocity": 0.0}, "a.drive_pros.max_velocity: must be positive; null means no limit"),
        (
            {"max_effort": "urdf"},
            "a.drive_pros.max_effort: expected a number or a map or 'file', got 'urdf'",
        ),
    ],
)
def test_a_drive_that_does_not_fit_is_named(drives, message):
    with pytest.raises(ConfigError) as raised:
        scene_of({"a": ur10(**drives)})
    assert str(raised.value) == message
