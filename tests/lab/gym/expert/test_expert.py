"""The policy `expert` solves tasks by the steps in their files, and says what fails."""

import re

import numpy as np
import pytest

import embodichain
from embodichain.lab.gym.expert.policy import Expert
from embodichain.lab.gym.expert.touches import is_touching, obstacles
from embodichain.lab.gym.policies import PlannedPolicy, resolve_policy
from embodichain.utils.math import (
    matrix_to_pose,
    pose_to_matrix,
    quat_to_matrix,
    rotate,
    rotvec_to_quat,
)

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

TOOL = "of: {uid: robot, control_parts: arm}"
LOOSE = "task.robot.drive_pros={stiffness: 0, damping: 0}"


class Performance:
    """One episode of an expert in all environments."""

    def __init__(
        self, task, num_envs=16, overrides=(), steps=None, change=None, policy=None, tool=None
    ):
        env = embodichain.make(task, num_envs=num_envs, overrides=["seed=3", *overrides])
        self.policy = policy = policy or (Expert(steps) if steps else resolve_policy("expert"))
        assert isinstance(policy, PlannedPolicy)
        self.actions = []
        try:
            obs, _ = env.reset()
            if change is not None:
                change(env)
            space = env.single_action_space
            for _ in range(env.max_episode_steps - 1):
                action = policy(obs, env)
                self.actions.append(action.numpy().copy())
                obs, _, terminated, truncated, info = env.step(action)
                assert not (terminated | truncated | info["diverged"]).any()
                self.success = info["metrics"]["success"].numpy() > 0
                if policy.done.all() and (self.success.all() or any(policy.failures) or steps):
                    break
            link = tool or ("panda_hand_tcp" if task == "lift_cube" else "gripper/tcp")
            self.tool = next(iter(env.sim.robots.values())).get_link_pose(link)
        finally:
            env.close()
        taken = np.stack(self.actions)
        assert (taken >= space.low).all() and (taken <= space.high).all()

    @property
    def failures(self):
        return list(self.policy.failures)


@pytest.mark.parametrize(
    ("task", "longest"),
    [
        ("pick_place", 130),
        ("stack_cubes", 150),
        ("clutter_pick", 190),
        ("lift_cube", 200),
        ("press_button", 100),
        ("open_drawer", 130),
        ("peg_in_hole", 220),
        ("hand_over", 280),
    ],
)
def test_the_expert_of_a_task_solves_it(task, longest):
    run = Performance(task)
    assert run.failures == [None] * 16
    assert run.success.all()
    assert len(run.actions) <= longest


def of_tool(term, *more):
    """Another action in place of the tool's."""
    return ["~task.actions.tool", f"+task.actions.arm={term}", *more]


@pytest.mark.parametrize(
    "overrides",
    [
        of_tool(f"{{func: eef_pose, params: {{{TOOL}}}}}"),
        of_tool(f"{{func: eef_pose, params: {{{TOOL}, frame: world, rotation: rpy}}}}"),
        of_tool(f"{{func: joint_action, params: {{{TOOL}}}}}"),
        of_tool(f"{{func: joint_action, params: {{{TOOL}, centre: target, scale: 0.05}}}}"),
        of_tool(f"{{func: joint_action, params: {{{TOOL}, centre: limits}}}}"),
        of_tool(f"{{func: operational_space, params: {{{TOOL}, command: pose}}}}", LOOSE),
        of_tool(f"{{func: operational_space, params: {{{TOOL}, frame: tool, scale: 0.1}}}}", LOOSE),
        of_tool(f"{{func: eef_delta_pose, params: {{{TOOL}, frame: tool, reference: qpos}}}}"),
        ["seed=3", "task.actions.gripper.params.command_mode=continuous"],
    ],
    ids=lambda overrides: overrides[1].partition("=")[2][:60],
)
def test_the_same_steps_work_through_every_action_that_moves_a_tool(overrides):
    run = Performance("pick_place", 3, [*overrides, "task.max_episode_steps=400"])
    assert run.failures == [None] * 3
    assert run.success.all()


def test_actions_do_not_depend_on_the_number_of_environments():
    many, few = (Performance("pick_place", n).actions for n in (5, 2))
    for step, (a, b) in enumerate(zip(many, few, strict=False)):
        assert np.array_equal(a[:2], b), step


# -- what fails ------------------------------------------------------------------------------------


def moved(uid, where):
    """Moves an object of the first environment away when the episode has begun."""

    def change(env):
        pose = env.sim.get_rigid_object(uid).get_local_pose()
        for row, place in where.items():
            pose[row, : len(place)] = place
        env.sim.get_rigid_object(uid).set_local_pose(pose)

    import torch

    where = {row: torch.tensor(place) for row, place in where.items()}
    return change


def test_a_target_out_of_reach_is_a_failure_of_its_environment_alone():
    run = Performance("pick_place", 3, change=moved("stand", {0: [0.65, 3.0, 0.72]}))
    assert run.failures[1:] == [None, None]
    assert run.failures[0].startswith("step 3, place stand: no straight line of the tool to (0.")
    assert run.success.tolist() == [False, True, True]
    assert run.policy.done.all()


def test_fingers_that_close_on_nothing_are_a_failure():
    steps = [{"grasp": {"of": "cube", "offset": [0.0, 0.0, 0.09]}}, {"lift": 0.1}]
    run = Performance("pick_place", 2, steps=steps)
    assert run.failures == ["step 1, grasp cube: the fingers closed on nothing"] * 2


def test_what_was_lost_is_a_failure():
    class Thief(Expert):
        """Takes the cube away when the tool is on its way with it."""

        calls = 0

        def __call__(self, obs, env):
            self.calls += 1
            if self.calls == 75:
                cube = env.sim.get_rigid_object("cube")
                pose = cube.get_local_pose()
                pose[1, :2] += 0.15
                cube.set_local_pose(pose)
            return super().__call__(obs, env)

    run = Performance("pick_place", 2, policy=Thief())
    assert run.failures == [None, "step 3, place stand: the gripper has lost cube"]


def test_a_tool_that_is_stopped_does_not_arrive():
    steps = [{"move_to": {"to": "world", "offset": [0.65, 0.0, 0.68]}}]  # in the table
    run = Performance("pick_place", 2, steps=steps)
    for failure in run.failures:
        assert failure.startswith("step 1, move_to world: the tool has not arrived, it is ")
        assert re.search(r"robot/gripper/left_finger touches table with \d+ N", failure)
        assert re.search(r"it is \d+ mm and \d\.\d\d rad from its goal: ", failure)


def test_a_tool_that_meets_nothing_says_so():
    """The drives are too weak for the way."""
    steps = [{"move_to": {"offset": [0.0, 0.0, 0.2]}}]
    run = Performance("pick_place", 2, ["task.robot.drive_pros.max_effort=0.3"], steps=steps)
    for failure in run.failures:
        assert failure.endswith(" rad from its goal: the robot touches nothing")


def test_two_objects_are_grasped_in_turn_and_environments_hold_different_ones():
    """The first cube is put beside the second, which is then put on it."""
    steps = [
        {"grasp": "cube"},
        {"lift": 0.1},
        {"place": {"to": "world", "offset": [0.6, -0.1, 0.727], "align": "world"}},
        {"grasp": "base"},
        {"lift": 0.1},
        {"place": {"to": "cube", "offset": [0.0, 0.0, 0.05], "align": "cube"}},
    ]
    held, poses = [], {}

    class Watched(Expert):
        def __call__(self, obs, env):
            action = super().__call__(obs, env)
            # The pose at which the expert believes the object is, in each step.
            held.append(self._execution._arms[0].grasp.object.copy())
            for uid in ("cube", "base"):
                poses[uid] = env.sim.get_rigid_object(uid).get_local_pose().numpy()
            return action

    slow = ["task.max_episode_steps=600", "task.events.place_cube.params.position_range="
            "[[-0.1,-0.2,0],[0.1,0.1,0]]"]  # fmt: skip
    run = Performance("stack_cubes", 4, slow, policy=Watched(steps))
    assert run.failures == [None] * 4
    offset = poses["base"][:, :3] - poses["cube"][:, :3]
    assert offset == pytest.approx(np.tile([0.0, 0.0, 0.05], (4, 1)), abs=0.006)
    mixed = [set(row.tolist()) for row in held]
    assert {0, 1} in mixed or {-1, 0, 1} in mixed or {-1, 1} in mixed
    assert {0} in mixed or {-1, 0} in mixed


def turned_about_the_fingers(env, uid, tool, angle):
    """Turn an object about the line between the fingers of a tool."""
    thing = env.sim.get_rigid_object(uid)
    pose = thing.get_local_pose(to_matrix=True).numpy().astype(np.float64)
    grip = env.sim.robots["right"].get_link_pose(tool, to_matrix=True).numpy().astype(np.float64)
    axis = grip[:, :3, 0]
    turn = quat_to_matrix(rotvec_to_quat(angle * axis))
    pose[:, :3, 3] = grip[:, :3, 3] + rotate(turn, pose[:, :3, 3] - grip[:, :3, 3])
    pose[:, :3, :3] = np.einsum("nij,njk->nik", turn, pose[:, :3, :3])
    thing.set_local_pose(matrix_to_pose(pose))


@pytest.mark.parametrize("gone", [False, True])
def test_what_turns_between_the_fingers_is_not_lost(gone):
    """The bar is held 15 cm off its middle, which moves 15 cm x 0.3 = 4.5 cm when it turns."""

    class Turner(Expert):
        turned = False

        def __call__(self, obs, env):
            action = super().__call__(obs, env)
            here = env.sim.get_rigid_object("bar").get_local_pose()[0, 2]
            if not self.turned and here > 0.35:
                self.turned = True
                turned_about_the_fingers(env, "bar", "gripper/tcp", 0.3)
                if gone:
                    pose = env.sim.get_rigid_object("bar").get_local_pose()
                    pose[:, 1] -= 0.3
                    env.sim.get_rigid_object("bar").set_local_pose(pose)
            return action

    grasp = {"arm": "right", "of": "bar", "offset": [0, -0.15, 0.008], "axes": "target"}
    steps = [{"grasp": {**grasp, "symmetry": 2}}, {"lift": {"arm": "right", "by": 0.2}}]
    policy = Turner(steps)
    run = Performance("hand_over", 1, policy=policy)
    assert policy.turned
    assert run.failures == (["step 2, lift: the gripper has lost bar"] if gone else [None])


def test_a_contact_is_named_with_the_force_between_the_bodies():
    """A cube of 0.1 kg at rest presses on the table with 0.981 N, one of 3 kg with 29.43 N."""
    heavy = "task.objects.base.attrs.mass=3"
    env = embodichain.make("stack_cubes", num_envs=2, overrides=["seed=1", heavy])
    try:
        env.reset()
        policy = resolve_policy("hold")
        for _ in range(30):
            env.step(policy(None, env))
        bodies = [env.sim.get_rigid_object(uid).entity.root_body_id for uid in ("cube", "base")]
        engine = env.sim.engine
        found = obstacles(engine, 1, bodies, ())
        assert found == "base touches table with 29.4 N, cube touches table with 0.981 N"
        table = {int(engine.model.body(0).id)} | {
            i for i in range(engine.model.nbody) if engine.model.body(i).name == "table"
        }
        assert "table touches base with 29.4 N" in obstacles(engine, 1, table, ())
        assert obstacles(engine, 1, table, bodies) == "the robot touches nothing"  # held: left out
        assert is_touching(engine, 1, bodies, table)
        assert not is_touching(engine, 1, bodies[:1], bodies[1:])
    finally:
        env.close()


def test_a_line_that_ends_says_where_and_at_which_joint():
    run = Performance("pick_place", 1, steps=[{"move_to": {"offset": [0.0, 0.0, 1.5]}}])
    number = r"-?\d+\.\d+"
    place = rf"\({number}, {number}, {number}\) m"
    assert re.fullmatch(
        rf"step 1, move_to: no straight line of the tool to {place}: "
        rf"after \d+ % of it, at {place}, "
        r".*(\d+ mm are missing at the next point|Joint\d would leap by \d\.\d\d rad)",
        run.failures[0],
    )


def test_a_reset_environment_begins_anew():
    env = embodichain.make("press_button", num_envs=2, overrides=["seed=1"])
    policy = resolve_policy("expert")
    obs, _ = env.reset()
    ended = 0
    for _ in range(2 * env.max_episode_steps):
        obs, _, _, truncated, info = env.step(policy(obs, env))
        if truncated.any():
            assert (info["metrics"]["success"] > 0).all()
            assert policy.done.all()
            ended += 1
            policy.reset(np.array([0, 1]))
            assert not policy.done.any()
    env.close()
    assert ended == 2


# -- steps -----------------------------------------------------------------------------------------


def where(env):
    """Poses that a function chooses: 10 cm above the stand."""
    pose = env.sim.get_rigid_object("stand").get_local_pose()
    pose[:, 2] += 0.1
    return pose


def test_steps_in_python_may_aim_at_what_a_function_returns():
    run = Performance("pick_place", 2, steps=[{"move_to": {"to": where, "tolerance": 0.003}}])
    assert run.failures == [None, None]
    assert run.tool[:, 2].numpy() == pytest.approx(0.82, abs=0.003)


def steps_of_a_function(env, height: float = 0.1):
    return [{"grasp": "cube"}, {"lift": height}]


def test_a_function_makes_the_steps():
    name = "tests.lab.gym.expert.test_expert:steps_of_a_function"
    run = Performance("pick_place", 2, steps={"func": name, "params": {"height": 0.2}})
    assert run.failures == [None, None]
    assert run.tool[:, 2].numpy() == pytest.approx(0.725 + 0.2, abs=0.03)


def test_repeated_waiting_and_moving():
    move = {"move_to": {"offset": [0.0, 0.0, -0.02], "tolerance": 0.002}}
    steps = [{"repeat": {"times": 3, "steps": [move, {"wait": 0.2}]}}]
    run = Performance("pick_place", 2, steps=steps)
    assert run.failures == [None, None]
    assert run.tool[:, 2].numpy() == pytest.approx(0.95 - 0.06, abs=0.002)


def test_two_arms_at_the_same_time():
    steps = [{"together": {arm: [{"lift": 0.1}, {"lift": 0.05}] for arm in ("right", "left")}}]
    both = Performance("hand_over", 2, steps=steps)
    steps = [{"lift": {"arm": arm, "by": 0.15}} for arm in ("right", "left")]
    one = Performance("hand_over", 2, steps=steps)
    assert both.failures == one.failures == [None, None]
    assert both.tool.numpy() == pytest.approx(one.tool.numpy(), abs=0.02)
    assert len(both.actions) < len(one.actions)


# -- goals -----------------------------------------------------------------------------------------


def rested(steps, task="pick_place", overrides=(), change=None):
    """Positions and axes of the tool when the steps are done; poses of the scene's first cube."""
    poses = []

    def look(env):
        if change is not None:
            change(env)
        if "cube" in env.sim.rigid_objects:
            poses.append(env.sim.get_rigid_object("cube").get_local_pose(to_matrix=True).numpy())

    run = Performance(task, 2, overrides, steps=steps, change=look)
    assert run.failures == [None, None]
    matrix = pose_to_matrix(run.tool.numpy().astype(np.float64))
    return matrix[:, :3, 3], matrix[:, :3, :3], poses


AT = {"offset": [0.05, 0.02, 0.15], "tolerance": 0.002}


@pytest.mark.parametrize("axes", ["world", "target", "tool"])
def test_an_offset_is_in_the_axes_of_its_frame(axes):
    offset = [0.05, 0.02, -0.15] if axes == "tool" else AT["offset"]
    step = {"move_to": {**AT, "to": "cube", "axes": axes, "offset": offset}}
    pos, turn, (cube,) = rested([step])
    frames = {"world": np.tile(np.eye(3), (2, 1, 1)), "target": cube[:, :3, :3], "tool": turn}
    wanted = cube[:, :3, 3] + frames[axes] @ np.array(offset)
    assert pos == pytest.approx(wanted, abs=0.0025)


def test_an_orientation_is_roll_pitch_yaw():
    _, turn, _ = rested([{"move_to": {"to": "cube", **AT, "rpy": [np.pi, 0.0, 0.3]}}])
    assert turn[:, :, 2] == pytest.approx(np.tile([0.0, 0.0, -1.0], (2, 1)), abs=0.03)
    angle = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    assert angle == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("symmetry", [4, 2, 1])
def test_a_tool_is_aligned_as_the_symmetry_allows(symmetry):
    step = {"move_to": {"to": "cube", **AT, "align": "cube", "symmetry": symmetry}}
    _, turn, (cube,) = rested([step])
    part = 2 * np.pi / symmetry
    angles = [np.arctan2(m[:, 1, 0], m[:, 0, 0]) for m in (turn, cube)]
    off = (angles[0] - angles[1] + part / 2) % part - part / 2
    assert np.abs(off).max() < 0.03


@pytest.mark.parametrize("rotation", ["keep", "free"])
def test_an_action_that_does_not_turn_the_tool(rotation):
    term = f"{{func: eef_pose, params: {{{TOOL}, rotation: {rotation}}}}}"
    pos, _, (cube,) = rested([{"move_to": {"to": "cube", **AT}}], overrides=of_tool(term))
    assert pos == pytest.approx(cube[:, :3, 3] + AT["offset"], abs=0.0025)


# -- steps that no shipped task has ----------------------------------------------------------------


def test_an_object_is_pushed_onto_a_disc():
    """The pusher of `push_cube` ends 8 cm above the middle of the cube."""
    step = {"of": "cube", "to": "goal", "behind": 0.075, "height": 0.08, "above": 0.12}
    faster = ["task.actions.arm.params.scale=0.03", "task.max_episode_steps=300"]
    run = Performance("push_cube", 8, faster, steps=[{"push": step}], tool="pusher")
    assert run.failures == [None] * 8
    assert run.success.sum() >= 6


def test_what_is_held_is_turned_to_a_target():
    """A cube in the air is aligned with another one and held above it."""
    above = {"to": "base", "offset": [0.0, 0.0, 0.15], "align": "base", "held": True}
    steps = [{"grasp": "cube"}, {"lift": 0.1}, {"move_to": {**above, "tolerance": 0.002}}]
    poses = []

    class Watched(Expert):
        def __call__(self, obs, env):
            objects = (env.sim.get_rigid_object(uid) for uid in ("cube", "base"))
            poses.append([one.get_local_pose(to_matrix=True).numpy() for one in objects])
            return super().__call__(obs, env)

    run = Performance("stack_cubes", 4, policy=Watched(steps))
    assert run.failures == [None] * 4
    cube, base = poses[-1]
    assert cube[:, :3, 3] == pytest.approx(base[:, :3, 3] + [0.0, 0.0, 0.15], abs=0.004)
    turns = [np.arctan2(pose[:, 1, 0], pose[:, 0, 0]) for pose in (cube, base)]
    off = (turns[0] - turns[1] + np.pi / 4) % (np.pi / 2) - np.pi / 4
    assert np.abs(off).max() < 0.05


def test_a_slower_step_takes_longer():
    fast, slow = (
        Performance("press_button", 2, steps=[{"lift": {"by": 0.2, "speed": speed}}])
        for speed in (1.0, 0.3)
    )
    assert len(slow.actions) > 1.7 * len(fast.actions)


def test_nothing_is_placed_where_nothing_is_held():
    run = Performance("pick_place", 2, steps=[{"place": "stand"}])
    assert run.failures == ["step 1, place stand: the gripper holds nothing"] * 2
    assert len(run.actions) == 1


def test_pushes_leave_the_path_and_the_expert_comes_back():
    calm = Performance("pick_place")
    pushed = Performance("pick_place", policy=Expert(pushes=0.5))
    assert pushed.success.sum() >= 15
    steps = min(len(calm.actions), len(pushed.actions), 60)
    before, after = (np.stack(run.actions[:steps]) for run in (calm, pushed))
    assert np.array_equal(before[0, :, 3:], after[0, :, 3:])  # the position alone is pushed
    differs = (np.abs(before - after).max(axis=2) > 1e-3).any(axis=0)
    assert differs.sum() >= 14  # of 60 steps hardly any environment has no push
    few = Performance("pick_place", num_envs=4, policy=Expert(pushes=0.5))
    steps = min(len(few.actions), len(pushed.actions), 60)
    for mine, whole in zip(few.actions[:steps], pushed.actions[:steps], strict=True):
        assert np.array_equal(mine, whole[:4])
