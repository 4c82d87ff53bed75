"""Motions of tools: `MovesTool.action_towards` of action terms, and `ToolPath`."""

import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.expert.arms import arms_of, declared_arms
from embodichain.lab.gym.expert.targets import TargetPoses, check_target
from embodichain.lab.gym.expert.trajectories import ToolPath
from embodichain.utils.errors import ConfigError
from embodichain.utils.math import quat_multiply, rotvec_to_quat

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N = 3
TOOL = "of: {uid: robot, control_parts: arm}"


@pytest.fixture
def built():
    made = []

    def build(task="pick_place", *overrides, num_envs=N):
        env = embodichain.make(task, num_envs=num_envs, overrides=["seed=2", *overrides])
        made.append(env)
        env.reset()
        return env

    yield build
    for env in made:
        env.close()


def with_tool(term):
    return "~task.actions.tool", f"+task.actions.arm={term}", "~task.expert"


@pytest.mark.parametrize(
    "term",
    [
        f"{{func: eef_pose, params: {{{TOOL}}}}}",
        f"{{func: eef_pose, params: {{{TOOL}, frame: world, rotation: rpy}}}}",
        f"{{func: eef_delta_pose, params: {{{TOOL}}}}}",
        f"{{func: eef_delta_pose, params: {{{TOOL}, frame: tool}}}}",
        f"{{func: eef_delta_pose, params: {{{TOOL}, frame: world, reference: qpos}}}}",
        f"{{func: joint_action, params: {{{TOOL}}}}}",
        f"{{func: joint_action, params: {{{TOOL}, centre: home, scale: 2}}}}",
        f"{{func: joint_action, params: {{{TOOL}, centre: limits}}}}",
        f"{{func: joint_action, params: {{{TOOL}, centre: target, scale: 0.2}}}}",
        f"{{func: joint_action, params: {{{TOOL}, centre: qpos, scale: 0.2}}}}",
    ],
)
def test_the_action_towards_a_pose_near_by_goes_there(built, term):
    """The drives' targets are there after one control step."""
    env = built("pick_place", *with_tool(term))
    ((_, arm),) = arms_of(env)
    qpos = env.robot.read_qpos().copy()
    pos, quat = arm.term.solver.forward(qpos)
    pos = pos + np.array([0.004, -0.006, 0.005])
    quat = quat_multiply(rotvec_to_quat(np.tile([0.01, 0.02, -0.03], (N, 1))), quat)
    wanted, reached = arm.term.solver.inverse(qpos, pos, quat)
    assert reached.all()
    action = env.action_manager.hold()
    action[:, arm.columns] = arm.term.action_towards(pos, quat, wanted[:, arm.term.solver.moving])
    env.step(torch.from_numpy(action.astype(np.float32)))
    target = env.robot.read_qpos().copy()
    target[:, :6] = env.robot.drives.read_target_qpos()[:, :6]
    found_pos, found_quat = arm.term.solver.forward(target)
    assert found_pos == pytest.approx(pos, abs=2e-4)
    assert np.abs((found_quat * quat).sum(axis=1)) == pytest.approx(1.0, abs=1e-5)


def test_an_action_stays_in_its_bounds_however_far_the_pose_is(built):
    env = built()
    ((_, arm),) = arms_of(env)
    pos, quat = arm.term.solver.forward(env.robot.read_qpos())
    action = arm.term.action_towards(pos + 3.0, quat, env.robot.read_qpos()[:, :6])
    assert action.max() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("term", "linear", "angular"),
    [
        (f"{{func: eef_delta_pose, params: {{{TOOL}}}}}", 0.5, 2.5),
        (f"{{func: eef_delta_pose, params: {{{TOOL}, scale: 0.01, clip: [-1, 2]}}}}", 0.25, 0.25),
        (f"{{func: eef_delta_pose, params: {{{TOOL}, rotation: keep}}}}", 0.5, np.inf),
        (f"{{func: eef_pose, params: {{{TOOL}}}}}", np.inf, np.inf),
    ],
)
def test_how_fast_an_action_can_move_a_tool(built, term, linear, angular):
    env = built("pick_place", *with_tool(term))
    ((_, arm),) = arms_of(env)
    assert arm.term.tool_speeds == pytest.approx((linear, angular))


# -- arms ------------------------------------------------------------------------------------------


def test_arms_and_grippers_of_two_robots(built):
    env = built("hand_over", num_envs=1)
    found = [(one.name, one.uid, one.gripper) for one, _ in arms_of(env)]
    wanted = [("right_tool", "right", "right_gripper"), ("left_tool", "left", "left_gripper")]
    assert found == wanted
    assert [(one.name, one.uid, one.gripper) for one in declared_arms(env.cfg)] == wanted
    for _, arm in arms_of(env):
        assert arm.gripper.asset is arm.asset
        assert arm.fingers.start == arm.columns.stop


def test_a_robot_without_action_terms_is_an_arm(built):
    unbounded = "task.events.place_goal.params.reachable_by=null"
    env = built(
        "reach", "~task.actions.arm", "~task.rewards", "~task.observations.action", unbounded
    )
    ((declared, arm),) = arms_of(env)
    assert (declared.name, declared.uid, declared.gripper) == ("", "robot", None)
    qpos = env.robot.read_qpos() + 0.1
    assert arm.term.action_towards(None, None, qpos) == pytest.approx(qpos)


def test_efforts_are_no_arm(built):
    efforts = "task.actions.arm.params={control: effort, centre: zero, scale: 1}"
    env = built("reach", efforts, "~task.expert")
    assert arms_of(env) == []
    assert declared_arms(env.cfg) == []


def test_the_opening_of_a_gripper_is_measured(built):
    env = built()
    ((_, arm),) = arms_of(env)
    assert arm.gripper.opening() == pytest.approx(1.0, abs=0.01)
    action = env.action_manager.hold()
    action[:, arm.fingers] = -1.0
    before = arm.gripper.opening()
    for _ in range(40):
        env.step(torch.from_numpy(action.astype(np.float32)))
        assert (arm.gripper.opening() <= before + 0.02).all()
        before = arm.gripper.opening()
    assert before == pytest.approx(0.0, abs=0.005)


# -- paths -----------------------------------------------------------------------------------------


def follow(env, path, arm, steps):
    """Positions (steps, N, 3) and joint positions (steps, N, k) of the path."""
    places, joints = [], []
    for _ in range(steps):
        path.measure()
        action = env.action_manager.hold()
        action[:, arm.columns] = path.advance(np.zeros(N, np.bool_))
        env.step(torch.from_numpy(action.astype(np.float32)))
        places.append(path.path_pos.copy())
        joints.append(arm.term.solver.inverse(env.robot.read_qpos(), path.path_pos, path.path_quat))
    return np.stack(places), np.stack([qpos[:, :6] for qpos, _ in joints])


def planned(env, shift, turn=(0.0, 0.0, 0.0), speed=1.0):
    ((_, arm),) = arms_of(env)
    path = ToolPath(arm, N, env.step_dt)
    path.measure()
    rows = np.arange(N)
    path.rest(rows)
    pos, quat = path.pos + np.asarray(shift), path.quat
    quat = quat_multiply(rotvec_to_quat(np.tile(turn, (N, 1))), quat)
    return arm, path, pos, path.plan(rows, pos, quat, speed)


def test_a_path_is_a_straight_line_within_the_limits(built):
    env = built()
    shift = np.array([0.1, -0.25, -0.1])
    arm, path, pos, reached = planned(env, shift, (0.0, 0.0, 0.5))
    assert reached.all()
    start = path.pos.copy()
    places, joints = follow(env, path, arm, int(path.steps.max()))
    assert places[-1] == pytest.approx(pos, abs=1e-5)
    share = ((places - start) @ shift) / (shift @ shift)
    assert places - start == pytest.approx(share[..., None] * shift, abs=5e-4)
    assert (np.diff(share, axis=0) >= -1e-9).all()
    dt = env.step_dt
    assert np.linalg.norm(np.diff(places, axis=0), axis=2).max() / dt <= 0.5
    assert (np.abs(np.diff(joints, axis=0)).max(axis=(0, 1)) / dt <= arm.term.joint_speeds).all()
    speeds = np.diff(share, axis=0) * np.linalg.norm(shift) / dt
    assert np.abs(np.diff(speeds, axis=0)).max() / dt <= 5.5
    assert path.is_at_end().all()


def test_a_slower_path_takes_longer(built):
    env = built()
    *_, path, _, _ = planned(env, [0.0, 0.2, 0.0])
    fast = path.steps.copy()
    *_, path, _, _ = planned(env, [0.0, 0.2, 0.0], speed=0.25)
    assert (path.steps > 2.5 * fast).all()


def test_a_line_that_leaves_the_workspace_is_refused(built):
    env = built()
    shifts = np.array([[0.1, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
    _, path, _, reached = planned(env, shifts)
    assert reached.tolist() == [True, False, True]
    assert path.steps[1] == 1


def test_what_is_missing_at_the_end_is_corrected(built):
    env = built("pick_place", "task.robot.gravcomp=0")  # the arm sags
    arm, path, _, _ = planned(env, [0.0, 0.1, 0.0])
    follow(env, path, arm, int(path.steps.max()) + 10)
    path.measure()
    sagging = path.remaining()[0]
    for _ in range(60):
        path.measure()
        action = env.action_manager.hold()
        action[:, arm.columns] = path.advance(np.ones(N, np.bool_))
        env.step(torch.from_numpy(action.astype(np.float32)))
    path.measure()
    assert sagging.min() > 0.005
    assert path.remaining()[0].max() < 0.001


# -- targets ---------------------------------------------------------------------------------------


def test_poses_of_targets(built):
    env = built("press_button")
    targets = TargetPoses(env)
    for name in ("button", "button/cap", "world", "robot/gripper/tcp"):
        targets.add(name, "expert")
    button = env.sim.get_articulation("button")
    for name, pose in (
        ("button", button.get_local_pose()),
        ("button/cap", button.get_link_pose("cap")),
        ("robot/gripper/tcp", env.robot.get_link_pose("gripper/tcp")),
    ):
        pos, quat = targets(name)
        assert pos == pytest.approx(pose[:, :3].numpy(), abs=1e-6)
        assert np.abs((quat * pose[:, 3:].numpy()).sum(axis=1)) == pytest.approx(1.0)
    assert not targets("world")[0].any()


def test_a_function_must_return_poses(built):
    env = built("press_button")
    targets = TargetPoses(env)
    targets.add(lambda env: torch.zeros(N, 3), "expert")
    with pytest.raises(ValueError, match=r"a target must return \(3, 7\) poses, got \(3, 3\)"):
        # By the number that `add` gave it, which is the steps' own.
        targets(next(iter(targets._readers)))


def test_a_command_is_a_target(built):
    box = "[[0.5, 0, 0], [0.5001, 0.0001, 0.0001]]"
    pose = f"{{func: uniform_pose, params: {{of: {{uid: robot}}, position_range: {box}}}}}"
    speed = "{func: uniform_velocity, params: {of: {uid: robot}, ranges: {}}}"
    env = built("press_button", f"+task.commands.goal={pose}", f"+task.commands.run={speed}")
    targets = TargetPoses(env)
    targets.add("goal", "expert")
    assert targets("goal")[0] == pytest.approx(np.tile([0.5, 0.0, 0.7], (N, 1)), abs=2e-4)
    with pytest.raises(ConfigError, match="the command 'run' is not a pose or a position"):
        targets.add("run", "expert")


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("cube", None),
        ("goal", None),
        ("world", None),
        ("lamp", "'lamp' is a light"),
        ("gaol", "there are: cube; commands: goal"),
        ("cube/top", "no link of 'cube' matches 'top'; there are: cube"),
    ],
)
def test_a_target_is_checked(target, message):
    known = {"cube": "rigid object", "lamp": "light"}
    found = [str(p) for p in check_target(target, "expert.0", known, ["goal"])]
    assert len(found) == (message is not None)
    if message is not None:
        assert message in found[0]


# -- other robots and actions ----------------------------------------------------------------------

PANDA = "{uid: robot, control_parts: [gripper]}"


@pytest.mark.parametrize(
    "params",
    [
        f"{{of: {PANDA}, command_mode: binary, open_command: 0.04, close_command: 0.0}}",
        f"{{of: {PANDA}}}",
        f"{{of: {PANDA}, lower_command: 0.0, upper_command: 0.04}}",
        f"{{of: {PANDA}, width: [0.0, 0.08]}}",
    ],
)
def test_the_opening_of_fingers_with_joints(built, params):
    grip = f"+task.actions.fingers={{func: parallel_gripper, params: {params}}}"
    env = built("lift_cube", "~task.actions.gripper", grip, "~task.expert", num_envs=1)
    ((declared, arm),) = arms_of(env)
    assert (declared.name, declared.gripper) == ("arm", "fingers")
    assert arm.gripper.opening() == pytest.approx(1.0, abs=0.01)  # at 4 cm
    qpos = env.robot.get_qpos()
    qpos[:, -2:] = 0.01
    env.robot.set_qpos(qpos)
    env.robot.set_qpos(qpos, target=False)
    assert arm.gripper.opening() == pytest.approx(0.25, abs=0.01)


def test_a_redundant_arm_follows_a_line_without_leaps(built):
    env = built("lift_cube", num_envs=N)
    ((_, arm),) = arms_of(env)
    path = ToolPath(arm, N, env.step_dt)
    path.measure()
    rows = np.arange(N)
    path.rest(rows)
    shifts = np.array([[0.1, 0.2, -0.1], [-0.1, -0.2, 0.1], [0.0, 0.25, 0.2]])
    start = path.pos.copy()
    assert path.plan(rows, start + shifts, path.quat, 1.0).all()
    before = env.robot.read_qpos()[:, :7].copy()
    for _ in range(int(path.steps.max())):
        path.measure()
        action = env.action_manager.hold()
        action[:, arm.columns] = path.advance(np.zeros(N, np.bool_))
        env.step(torch.from_numpy(action.astype(np.float32)))
        now = env.robot.drives.read_target_qpos()[:, :7]
        assert (np.abs(now - before) <= arm.term.joint_speeds * env.step_dt + 1e-6).all()
        before = now.copy()
        way = path.path_pos - start
        share = (way * shifts).sum(axis=1) / (shifts * shifts).sum(axis=1)
        assert way == pytest.approx(share[:, None] * shifts, abs=1e-3)
    assert path.path_pos == pytest.approx(start + shifts, abs=1e-4)


@pytest.mark.parametrize(
    ("params", "linear"),
    [
        ("command: pose", 0.1 * np.sqrt(150) / 2),
        ("command: pose, stiffness: 600, damping_ratio: 2", 0.1 * np.sqrt(600) / 4),
        ("scale: 0.05", 0.05 * np.sqrt(150) / 2),
        ("scale: 0.5", 0.1 * np.sqrt(150) / 2),
    ],
)
def test_a_spring_pulls_a_tool_no_faster_than_its_damper_lets_it(built, params, linear):
    term = f"{{func: operational_space, params: {{{TOOL}, {params}}}}}"
    loose = "task.robot.drive_pros={stiffness: 0, damping: 0}"
    env = built("pick_place", *with_tool(term), loose, num_envs=1)
    ((_, arm),) = arms_of(env)
    assert arm.term.tool_speeds[0] == pytest.approx(linear)
    assert (arm.term.joint_speeds > 2.0).all()


def test_planning_does_not_depend_on_the_number_of_environments(built):
    found = []
    for count in (5, 2):
        env = built(num_envs=count)
        ((_, arm),) = arms_of(env)
        path = ToolPath(arm, count, env.step_dt)
        path.measure()
        rows = np.arange(count)
        path.rest(rows)
        shifts = np.random.default_rng(0).uniform(-0.1, 0.1, (5, 3))[:count]
        assert path.plan(rows, path.pos + shifts, path.quat, 1.0).all()
        for _ in range(10):
            path.measure()
            action = path.advance(np.zeros(count, np.bool_))
        found.append((path.steps[:2].copy(), action[:2], path.path_pos[:2]))
    for many, few in zip(*found, strict=True):
        assert np.array_equal(many, few)
