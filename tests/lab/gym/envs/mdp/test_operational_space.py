"""Impedance control of a tool: against gravity, pushes, in the null space, in the log."""

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import embodichain.recording as recording
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import ActionTermCfg, EnvCfg
from embodichain.lab.sim.cfg import (
    JointDrivePropertiesCfg,
    RobotCfg,
    SimulationManagerCfg,
    SolverCfg,
)
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME, UR10

PANDA = "panda_description/urdf/panda.urdf"
READY = [0.0, -0.57, 0.0, -2.2, 0.0, 2.4, 0.74, 0.04, 0.04]
ARM = {"uid": "panda", "control_parts": "arm"}
OFF = {"arm": 0.0, "hand": 1e3}


def panda(num_envs: int = 2, **params) -> BaseEnv:
    """A Panda under gravity without compensation, with efforts at 250 Hz."""
    robot = RobotCfg(
        uid="panda",
        fpath=PANDA,
        init_pos=(0.2, -0.1, 0.4),
        init_rot=(0.0, 0.0, 90.0),
        init_qpos=READY,
        control_parts={"arm": ["panda_joint[1-7]"], "hand": ["panda_finger_joint.*"]},
        solver_cfg={"arm": SolverCfg(end_link_name="panda_hand")},
        drive_pros=JointDrivePropertiesCfg(stiffness=OFF, damping=OFF, max_effort="file"),
    )
    params = {"entity_cfg": ARM, **params}
    cfg = EnvCfg(
        num_envs=num_envs,
        seed=3,
        sim_cfg=SimulationManagerCfg(headless=True, num_threads=1, physics_dt=0.004),
        sim_steps_per_control=5,
        robot=robot,
        actions={"tool": ActionTermCfg(func="operational_space", params=params)},
    )
    env = BaseEnv(cfg)
    env.reset()
    return env


def tool(env, link: str = "panda_hand") -> tuple[np.ndarray, Rotation]:
    pose = env.robot.get_link_pose(link).double().numpy()
    return pose[:, :3], Rotation.from_quat(pose[:, 3:], scalar_first=True)


def act(env, rows, steps: int = 1) -> dict:
    action = torch.as_tensor(np.asarray(rows, np.float32))
    for _ in range(steps):
        info = env.step(action.expand(env.num_envs, -1).contiguous())[4]
    return info["metrics"]


def push(env, force) -> None:
    """Apply forces in world axes, (3,) or (N, 3) N, at the centre of mass of the hand."""
    body = env.robot.body_of("panda_hand")
    env.sim.engine.write("xfrc_applied", force, None, 6 * body + np.arange(3))


@pytest.mark.parametrize("decoupling", [True, False])
def test_the_tool_stays_under_gravity_and_follows_a_circle(decoupling) -> None:
    gains = {} if decoupling else {"stiffness": {"[xyz]": 1500.0, "r[xyz]": 100.0}}
    env = panda(command="pose", frame="world", decoupling=decoupling, **gains)
    home = env.action_manager.home()
    before, turned = tool(env)
    assert np.abs(before - home[:3]).max() < 1e-5
    metrics = act(env, home, 50)
    pos, turn = tool(env)
    assert np.abs(pos - before).max() < 1e-5
    assert (turn.inv() * turned).magnitude().max() < 1e-4
    assert metrics["tool/position_error"].max() < 1e-5 and not metrics["tool/saturated"].any()
    missed = []
    for step in range(150):  # 5 cm, 2 s
        angle = 2 * np.pi * min(step / 100, 1.0)
        place = home[:3] + 0.05 * np.array([0.0, np.sin(angle), np.cos(angle) - 1.0])
        act(env, [*place, *home[3:]])
        missed.append(np.linalg.norm(tool(env)[0] - place, axis=1).max())
    # The lag of a critically damped spring: 2 / sqrt(150) s behind 0.157 m/s is 26 mm.
    assert max(missed) < 0.03 and missed[-1] < 1e-3
    assert (tool(env)[1].inv() * turned).magnitude().max() < 0.02
    env.close()


@pytest.mark.parametrize("decoupling", [True, False])
def test_a_push_displaces_the_tool_as_a_spring(decoupling) -> None:
    stiffness = {"x": 200.0, "y": 400.0, "z": 300.0, "r[xyz]": 200.0}
    if not decoupling:
        stiffness = {"x": 500.0, "y": 1000.0, "z": 800.0, "r[xyz]": 100.0}
    env = panda(3, frame="world", reference="target", decoupling=decoupling, stiffness=stiffness)
    act(env, [0.0] * 6, 10)
    before, turned = tool(env)
    forces = np.array([[20.0, 0.0, 0.0], [0.0, -20.0, 0.0], [0.0, 0.0, 20.0]])
    push(env, forces)
    act(env, [0.0] * 6, 200)
    pos, turn = tool(env)
    shift = np.concatenate([pos - before, (turn * turned.inv()).as_rotvec()], axis=1)
    for i in range(3):
        data, model = env.sim.engine.data_of(i), env.sim.engine.model_of(i)
        body, dofs = env.robot.body_of("panda_hand"), env.robot.index.dof_adr[:7]
        lever = data.xipos[body] - data.xpos[body]
        wrench = np.concatenate([forces[i], np.cross(lever, forces[i])])
        gains = np.array([*list(stiffness.values())[:3], *[stiffness["r[xyz]"]] * 3])
        if decoupling:  # an acceleration: the inverse of the apparent mass times the wrench
            jacobian, full = np.zeros((6, model.nv)), np.zeros((model.nv, model.nv))
            mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
            mujoco.mj_fullM(model, data, full)
            jacobian, full = jacobian[:, dofs], full[np.ix_(dofs, dofs)]
            wrench = jacobian @ np.linalg.solve(full, jacobian.T @ wrench)
        expected = wrench / gains
        assert np.abs(expected[:3]).max() > 5e-3
        assert np.abs(shift[i] - expected).max() < 0.02 * np.abs(expected).max()
    push(env, 0.0)
    act(env, [0.0] * 6, 100)
    assert np.abs(tool(env)[0] - before).max() < 1e-4
    env.close()


def test_the_elbow_moves_to_the_posture_and_the_tool_does_not() -> None:
    posture = [0.5, -0.57, -0.4, -2.2, 0.3, 2.4, 0.9]
    env = panda(reference="target", posture=posture, posture_stiffness=20.0)
    before, turned = tool(env)
    elbow = tool(env, "panda_link4")[0]
    missed = []
    for _ in range(100):
        act(env, [0.0] * 6)
        missed.append(np.abs(tool(env)[0] - before).max())
    assert max(missed) < 2e-3
    assert (tool(env)[1].inv() * turned).magnitude().max() < 5e-3
    assert np.linalg.norm(tool(env, "panda_link4")[0] - elbow, axis=1).min() > 0.03
    qpos = env.robot.get_qpos().double().numpy()[:, :7]
    assert np.abs(qpos - posture)[:, [0, 2]].max() < 0.1
    env.close()


def test_a_far_pose_is_approached_at_a_bounded_speed() -> None:
    env = panda(command="pose", frame="world", rotation="keep", stiffness=400.0)
    home = env.action_manager.home()
    far = home + np.array([-0.25, 0.1, -0.2])
    before, speeds = tool(env)[0], []
    for _ in range(100):
        act(env, far)
        pos = tool(env)[0]
        speeds.append(np.linalg.norm(pos - before, axis=1).max() / env.step_dt)
        before = pos
    assert np.abs(pos - far).max() < 1e-3
    # Without a bound a critically damped spring reaches 0.37 x sqrt(400) x 0.34 m = 2.5 m/s.
    assert 0.6 < max(speeds) < 0.1 * np.sqrt(400.0) / 2 + 0.05
    env.close()


FRAMES = {"world": [0.0, 1.0, 0.0], "base": [-1.0, 0.0, 0.0], "tool": None}


@pytest.mark.parametrize("frame", FRAMES)
def test_relative_motion_and_a_free_axis_in_each_frame(frame) -> None:
    env = panda(frame=frame, reference="target", scale=0.01,
                stiffness={"[xz]": 400.0, "y": 0.0, "r[xyz]": 200.0})  # fmt: skip
    before, turned = tool(env)
    act(env, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 3)
    act(env, [0.0] * 6, 60)
    up = turned[0].apply([0.0, 0.0, 1.0]) if frame == "tool" else np.array([0.0, 0.0, 1.0])
    free = turned[0].apply([0.0, 1.0, 0.0]) if frame == "tool" else np.array(FRAMES[frame])
    moved = tool(env)[0] - before
    assert np.abs((moved - 0.03 * up) @ up).max() < 1e-3
    push(env, 2.0 * free)
    act(env, [0.0] * 6, 30)
    moved = tool(env)[0] - before - moved
    assert (moved @ free > 0.03).all()
    assert np.linalg.norm(moved - np.outer(moved @ free, free), axis=1).max() < 0.02
    env.close()


def test_efforts_stay_within_the_limits_and_saturation_is_flagged() -> None:
    env = panda(command="pose", rotation="keep", stiffness=5000.0)
    home = env.action_manager.home()
    assert not act(env, home, 2)["tool/saturated"].any()
    assert act(env, home + np.array([0.3, 0.0, 0.0]))["tool/saturated"].all()
    applied = np.abs(env.sim.engine.state("qfrc_applied")[:, :7])
    limits = np.array([87.0] * 4 + [12.0] * 3)
    assert (applied <= limits).all()
    env.close()


@pytest.mark.parametrize(
    "params",
    [
        {"frame": "tool", "rotation": "keep"},
        {"decoupling": False, "damping_ratio": {"x": 0.5}},
        {"command": "pose", "rotation": "free", "posture": 0.1},
    ],
)
def test_rows_do_not_depend_on_the_number_of_environments(params) -> None:
    actions = np.random.default_rng(0).uniform(-1, 1, (8, 33, 6)).astype(np.float32)
    rows = []
    for count in (33, 1, 2):
        env = panda(count, **params)
        actions = actions[..., : env.action_manager.action_dim]
        for action in actions:
            env.step(torch.from_numpy(action[:count].copy()))
        rows.append(env.sim.engine.rows[:2].copy())
        env.close()
    assert np.ptp(rows[0], axis=0).max() > 0.01
    assert np.array_equal(rows[0][:1], rows[1]) and np.array_equal(rows[0], rows[2])


def test_a_restored_environment_continues_to_the_bit_and_its_log_verifies(tmp_path) -> None:
    env = panda(reference="target")
    recorder = recording.McapRecorder(tmp_path / "a.mcap", env)
    env.add_observer(recorder)
    env.reset()
    act(env, [1.0, 0.0, -1.0, 0.2, 0.0, 0.4], 4)
    state = env.state_dict()
    act(env, [0.0, 1.0, -1.0, 0.2, 0.0, 0.4], 4)
    rows = env.sim.engine.rows.copy()
    env.load_state_dict(state)
    act(env, [0.0, 1.0, -1.0, 0.2, 0.0, 0.4], 4)
    assert np.array_equal(env.sim.engine.rows, rows)
    env.reset(options={"env_ids": [1]})
    act(env, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 3)
    env.close()
    assert recording.verify(tmp_path / "a.mcap").ok


@pytest.mark.parametrize("decoupling", [True, False])
def test_an_environment_that_diverges_leaves_the_others_alone(decoupling) -> None:
    rows = []
    for diverges in (True, False):
        env = panda(2, decoupling=decoupling)
        if diverges:
            env.sim.engine.write("qvel", 1e200, np.array([1]))
        info = env.step(torch.full((2, 6), 0.5))[4]
        assert info["diverged"].tolist() == [False, diverges]
        rows.append(env.sim.engine.rows[0].copy())
        env.close()
    assert np.array_equal(*rows)


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"command": "pose", "scale": 0.1}, "scale: has no meaning with command: pose"),
        ({"position_range": [[0, 0, 0], [1, 1, 1]]}, "no meaning with command: delta"),
        ({"command": "pose", "frame": "tool"}, "base or world"),
        ({"rotation": "rpy"}, "command: pose"),
        ({"stiffness": {"x": 1.0}}, "says nothing about columns: y"),
        ({"stiffness": -1.0}, "must not be negative"),
        ({"posture": [0.0]}, "posture: needs one value or 7"),
    ],
)
def test_mistakes_are_named(params, message) -> None:
    with pytest.raises(ConfigError, match=message):
        panda(**params)


def test_drives_that_are_on_are_refused_and_none_are_needed(make) -> None:
    term = ActionTermCfg(func="operational_space", params={"entity_cfg": {"uid": "ur10"}})
    robot = RobotCfg(uid="ur10", fpath=UR10, init_pos=(0, 0, 1), init_qpos=HOME)
    with pytest.raises(ConfigError, match=r"Joint1: 0.*drive_pros"):
        make(robot=robot, actions={"tool": term})
    drives = JointDrivePropertiesCfg(drive_type="none")
    robot = RobotCfg(uid="ur10", fpath=UR10, init_qpos=HOME, drive_pros=drives, init_pos=(0, 0, 1))
    env = make(robot=robot, actions={"tool": term}, max_episode_steps=-1)
    env.reset()
    before, _ = tool(env, "ee_link")
    act(env, [0.0] * 6, 30)
    assert np.abs(tool(env, "ee_link")[0] - before).max() < 1e-3
