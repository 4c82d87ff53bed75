"""Actions of a robot's tool: what it follows, what it cannot reach, two arms at once."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import ActionTermCfg, EnvCfg
from embodichain.lab.sim.cfg import RobotCfg, SimulationManagerCfg, SolverCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME, UR10

PANDA = "panda_description/urdf/panda.urdf"
READY = [0.0, -0.57, 0.0, -2.81, 0.0, 3.04, 0.74, 0.04, 0.04]
ARM = {"uid": "panda", "control_parts": "arm"}


def panda(func: str, num_envs: int = 2, **params) -> BaseEnv:
    robot = RobotCfg(
        uid="panda",
        fpath=PANDA,
        init_pos=(0.2, -0.1, 0.4),
        init_rot=(0.0, 0.0, 90.0),
        init_qpos=READY,
        gravcomp=1.0,
        control_parts={"arm": ["panda_joint[1-7]"], "hand": ["panda_finger_joint.*"]},
        solver_cfg={"arm": SolverCfg(end_link_name="panda_hand")},
    )
    cfg = EnvCfg(
        num_envs=num_envs,
        seed=3,
        sim_cfg=SimulationManagerCfg(headless=True, num_threads=1),
        robot=robot,
        actions={"tool": ActionTermCfg(func=func, params={"entity_cfg": ARM, **params})},
    )
    env = BaseEnv(cfg)
    env.reset()
    return env


def ur10(make, func: str, **params):
    term = ActionTermCfg(func=func, params={"entity_cfg": {"uid": "ur10"}, **params})
    robot = RobotCfg(uid="ur10", fpath=UR10, init_pos=(0, 0, 1), init_qpos=HOME, gravcomp=1.0)
    env = make(robot=robot, actions={"tool": term}, max_episode_steps=-1)
    env.reset()
    return env


def tool(env, link: str = "panda_hand") -> tuple[np.ndarray, Rotation]:
    pose = env.robot.get_link_pose(link).double().numpy()
    return pose[:, :3], Rotation.from_quat(pose[:, 3:], scalar_first=True)


def act(env, rows) -> dict:
    action = torch.as_tensor(np.asarray(rows, np.float32))
    return env.step(action.expand(env.num_envs, -1).contiguous())[4]


def test_a_pandas_tool_follows_a_circle() -> None:
    env = panda("eef_pose", frame="world")
    assert env.single_action_space.shape == (7,)
    assert env.action_manager.names[0] == "tool/x" and env.action_manager.names[3] == "tool/qw"
    home = env.action_manager.home()
    centre, missed = home[:3] - np.array([0.0, 0.0, 0.05]), []
    for step in range(150):
        angle = np.pi / 2 + 2 * np.pi * min(step / 100, 1.0)
        place = centre + 0.05 * np.array([0.0, np.cos(angle), np.sin(angle)])
        info = act(env, [*place, *home[3:]])
        pos, turn = tool(env)
        if step > 10:
            missed.append(np.linalg.norm(pos - place, axis=1).max())
    wanted = Rotation.from_quat(home[3:], scalar_first=True)
    # Joints follow their targets a little later; at rest the tool is at the target.
    assert max(missed) < 0.01 and missed[-1] < 1e-3
    assert (turn.inv() * wanted).magnitude().max() < 5e-3
    metrics = info["metrics"]
    assert metrics["tool/position_error"].max() < 1e-4
    assert metrics["tool/rotation_error"].max() < 1e-4
    assert not metrics["tool/unreachable"].any()
    assert np.ptp(pos, axis=0).max() < 1e-9  # environments move alike
    env.close()


@pytest.mark.parametrize("rotation", ["keep", "free"])
def test_what_is_out_of_reach_is_approached_without_jumps_and_flagged(make, rotation) -> None:
    speed = 0.8
    env = ur10(make, "eef_pose", frame="world", rotation=rotation, max_velocity=speed,
               position_range=[[-9, -9, -9], [9, 9, 9]])  # fmt: skip
    target = np.array([3.0, 0.5, 1.4])
    before, errors, flags = env.robot.drives.read_target_qpos().copy(), [], []
    for _ in range(150):
        metrics = act(env, target)["metrics"]
        now = env.robot.drives.read_target_qpos().copy()
        assert np.abs(now - before).max() <= speed * env.step_dt + 1e-12
        before = now
        error = metrics["tool/position_error"].double().numpy()
        turned = metrics.get("tool/rotation_error", torch.zeros(3)).double().numpy()
        errors.append(np.hypot(error, turned)[0])
        flags.append(float(metrics["tool/unreachable"][0]))
    assert (np.diff(errors) < 1e-4).all()
    assert errors[0] > errors[-1] + 0.3 and errors[-1] > 0.5
    assert flags[0] == 0.0 and flags[-20:] == [1.0] * 20
    assert np.abs(np.diff(before)).max() < 10 and np.isfinite(before).all()
    # It points at the target: no farther point of a UR10 (1.3 m from its shoulder) is nearer.
    if rotation == "free":
        pos, _ = tool(env, "ee_link")
        away = pos[0] - [0, 0, 1.12]
        ahead = away @ (target - [0, 0, 1.12]) / np.linalg.norm(target - [0, 0, 1.12])
        assert ahead > 1.2 and ahead > 0.97 * np.linalg.norm(away)
    back = env.action_manager.home()
    for _ in range(150):
        metrics = act(env, back)["metrics"]
    assert metrics["tool/position_error"].max() < 1e-3
    assert not metrics["tool/unreachable"].any()


FRAMES = {
    "world": ([0.0, 1.0, 0.0], "fixed"),
    "base": ([0.0, 1.0, 0.0], "root"),
    "tool": ([0.0, 1.0, 0.0], "tool"),
}


@pytest.mark.parametrize("frame", FRAMES)
def test_relative_motion_in_each_frame(frame) -> None:
    env = panda("eef_delta_pose", frame=frame, scale={"[xyz]": 0.005, "r[xyz]": 0.02})
    before, turned = tool(env)
    for _ in range(10):
        act(env, [0.0, 1.0, 0.0, 0.0, 0.0, 0.5])
    for _ in range(15):
        metrics = act(env, [0.0] * 6)["metrics"]
    pos, turn = tool(env)
    root = Rotation.from_euler("z", 90, degrees=True)
    axes = {"world": Rotation.identity(), "base": root}
    spin = Rotation.from_rotvec([0, 0, 0.1])
    if frame == "tool":  # an arc: the sum of ten steps, each about the tool as it then is
        expected, now = before.copy(), turned
        for _ in range(10):
            expected = expected + now.apply([0.0, 0.005, 0.0])
            now = now * Rotation.from_rotvec([0, 0, 0.01])
    else:
        expected = before + axes[frame].apply([0.0, 0.05, 0.0])
        now = (axes[frame] * spin * axes[frame].inv()) * turned
    assert np.abs(pos - expected).max() < 1e-3
    assert (turn.inv() * now).magnitude().max() < 5e-3
    assert metrics["tool/position_error"].max() < 1e-5
    env.close()


@pytest.mark.parametrize(("rotation", "columns"), [("keep", 3), ("free", 3), ("command", 6)])
def test_columns_and_orientation_of_relative_motion(rotation, columns) -> None:
    env = panda("eef_delta_pose", rotation=rotation)
    assert env.single_action_space.shape == (columns,)
    before, turned = tool(env)
    for _ in range(10):
        act(env, [0.25, 0.25, 0.25] + [0.0] * (columns - 3))
    for _ in range(10):
        act(env, [0.0] * columns)
    pos, turn = tool(env)
    assert np.abs(pos - before - np.array([-0.05, 0.05, 0.05])).max() < 1e-3
    angle = (turn.inv() * turned).magnitude().max()
    assert angle > 0.05 if rotation == "free" else angle < 0.01
    env.close()


def test_zero_and_hold_keep_the_tool_where_it_is(make) -> None:
    env = ur10(make, "eef_delta_pose")
    home = env.robot.drives.read_target_qpos().copy()
    for _ in range(20):
        act(env, [0.0] * 6)
    assert np.abs(env.robot.drives.read_target_qpos() - home).max() < 1e-12
    env = ur10(make, "eef_pose", rotation="quat")
    for _ in range(5):
        act(env, [0.7, 0.3, 0.4, 0.0, 0.0, 0.0, 0.0])  # a quaternion 0: no rotation
    held = env.robot.drives.read_target_qpos().copy()
    hold = env.action_manager.hold()
    for _ in range(10):
        env.step(torch.as_tensor(hold, dtype=torch.float32))
    assert np.abs(env.robot.drives.read_target_qpos() - held).max() < 1e-5


@pytest.mark.parametrize("rotation", ["quat", "rpy", "keep", "free"])
def test_home_goes_back_to_the_initial_pose(make, rotation) -> None:
    env = ur10(make, "eef_pose", rotation=rotation, posture_gain=0.2)
    before, turned = tool(env, "ee_link")
    shift = np.zeros(len(env.action_manager.home()))
    shift[:3] = [0.05, -0.1, 0.1]
    for _ in range(30):
        act(env, env.action_manager.home() + shift)
    assert np.linalg.norm(tool(env, "ee_link")[0] - before, axis=1).min() > 0.1
    for _ in range(80):
        act(env, env.action_manager.home())
    pos, turn = tool(env, "ee_link")
    assert np.abs(pos - before).max() < 3e-3
    if rotation != "free":
        assert (turn.inv() * turned).magnitude().max() < 0.02


def test_two_arms_at_once_follow_their_own_targets() -> None:
    arm = {"fpath": UR10, "init_qpos": HOME, "gravcomp": 1.0}
    robots = {
        "left": RobotCfg(uid="left", init_pos=(0.0, 0.8, 0.5), **arm),
        "right": RobotCfg(uid="right", init_pos=(0.0, -0.8, 0.5), init_rot=(0, 0, 40), **arm),
    }
    terms = {
        name: ActionTermCfg(
            func="eef_pose",
            params={"entity_cfg": {"uid": name}, "rotation": "keep", "frame": "world"},
        )
        for name in robots
    }
    cfg = EnvCfg(
        num_envs=2,
        seed=1,
        sim_cfg=SimulationManagerCfg(headless=True, num_threads=1),
        robot=robots["left"],
        articulations={"right": robots["right"]},
        actions=terms,
    )
    env = BaseEnv(cfg)
    env.reset()
    action = env.action_manager.home() + np.array([0.1, 0.0, -0.1, 0.05, 0.1, 0.05])
    for _ in range(80):
        metrics = act(env, action)["metrics"]
    assert metrics["left/position_error"].max() < 1e-3
    assert metrics["right/position_error"].max() < 1e-3
    for name, wanted in (("left", action[:3]), ("right", action[3:])):
        handle = env.scene_entity({"uid": name, "link_names": "ee_link"})
        assert np.abs(handle.position() - wanted).max() < 5e-3
    env.close()


def test_a_restored_environment_continues_to_the_bit() -> None:
    env = panda("eef_delta_pose", reference="qpos")
    for _ in range(5):
        act(env, [1.0, 0.0, -1.0, 0.2, 0.0, 0.4])
    state = env.state_dict()
    for _ in range(5):
        act(env, [0.0, 1.0, -1.0, 0.2, 0.0, 0.4])
    rows = env.sim.engine.rows.copy()
    env.load_state_dict(state)
    for _ in range(5):
        act(env, [0.0, 1.0, -1.0, 0.2, 0.0, 0.4])
    assert np.array_equal(env.sim.engine.rows, rows)
    env.close()


@pytest.mark.parametrize(
    ("func", "params", "message"),
    [
        ("eef_pose", {"entity_cfg": {"uid": "cube"}}, "has no joints"),
        ("eef_pose", {"entity_cfg": {"uid": "ur10", "link_names": ["base_link"]}}, "moves"),
        ("eef_pose", {"max_velocity": -1.0}, "must be positive"),
        ("eef_pose", {"position_range": [[1, 0, 0], [0, 1, 1]]}, "position_range"),
        ("eef_delta_pose", {"scale": {"q.*": 1.0}}, "no column of this term matches"),
        ("eef_delta_pose", {"frame": "hand"}, "frame"),
        (
            "eef_delta_pose",
            {"entity_cfg": {"uid": "ur10", "link_names": ["forearm_link", "ee_link"]}},
            "cannot tell which link is the tool",
        ),
    ],
)
def test_mistakes_are_named(make, func, params, message) -> None:
    given = {"entity_cfg": {"uid": "ur10"}, **params}
    with pytest.raises(ConfigError, match=message):
        make(actions={"tool": ActionTermCfg(func=func, params=given)})


def test_embodichains_names(make) -> None:
    env = ur10(make, "absolute_eef_pose", pose_dim=6)
    assert env.action_manager.names[3:] == ("tool/roll", "tool/pitch", "tool/yaw")
    env = ur10(make, "relative_eef_pose", translation_scale=0.01, rotation_scale=0.2)
    before, turned = tool(env, "ee_link")
    act(env, [0.0, 0.0, 1.0, 0.0, 0.0, 0.25])
    pose = env.robot.compute_fk(env.robot.get_qpos(target=True)).double().numpy()
    assert np.abs(pose[:, :3] - before - np.array([0.0, 0.0, 0.01])).max() < 2e-4
    spin = Rotation.from_quat(pose[:, 3:], scalar_first=True) * turned.inv()
    assert np.abs(spin.as_rotvec() - np.array([0.0, 0.0, 0.05])).max() < 1e-3
