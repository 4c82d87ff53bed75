"""`policy: teleop`: what a person's command does to the tool, gripper and episode."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import embodichain
from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.gym.policies import PlannedPolicy, resolve_policy
from embodichain.lab.gym.teleop import DISCARDED, Teleop, ToolCommand
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import UR10, builder

HOME = [0.3, -1.3, 1.7, -1.2, -1.2, 0.4]
OFF = JointDrivePropertiesCfg(stiffness=0.0, damping=0.0)
EEF = {
    "delta, base": ("eef_delta_pose", {"frame": "base"}),
    "delta, tool, measured": ("eef_delta_pose", {"frame": "tool", "reference": "qpos"}),
    "delta, world": ("eef_delta_pose", {"frame": "world", "scale": 0.05}),
    "pose, base": ("eef_pose", {}),
    "pose, world": ("eef_pose", {"frame": "world", "rotation": "rpy"}),
    "impedance, delta": ("operational_space", {"reference": "target", "frame": "base"}),
    "impedance, tool": ("operational_space", {"reference": "target", "frame": "tool"}),
    "impedance, measured": ("operational_space", {}),
    "impedance, pose": ("operational_space", {"command": "pose"}),
}


class Script:
    """An operator whose commands a test sets."""

    def __init__(self):
        self.now, self.begun = ToolCommand(), 0

    def command(self, begins):
        self.begun += begins
        return self.now

    def set(self, **changes):
        self.now = replace(self.now, **changes)


class Session:
    """An environment, its policy, and the operator."""

    def __init__(self, env, **params):
        self.env, self.operator = env, Script()
        self.policy = Teleop(**params)
        self.policy.operator = self.operator
        self.obs, _ = env.reset()

    def step(self, count=1):
        for _ in range(count):
            self.obs, _, terminated, truncated, info = self.env.step(
                self.policy(self.obs, self.env)
            )
        return bool(terminated[0] | truncated[0]), info

    @property
    def tool(self):
        pos, quat = self.policy.tool_pose()
        return pos, Rotation.from_quat(quat, scalar_first=True)


@pytest.fixture(scope="module")
def make():
    with builder() as build:

        def make(func, **params):
            robot = RobotCfg(
                uid="ur10",
                fpath=UR10,
                init_pos=(0.1, 0.2, 1.0),
                init_rot=(0.0, 0.0, 60.0),
                init_qpos=HOME,
                gravcomp=1.0,
                **({"drive_pros": OFF} if func == "operational_space" else {}),
            )
            term = ActionTermCfg(func=func, params={"of": {"uid": "ur10"}, **params})
            env = build(robot=robot, num_envs=1, actions={"tool": term}, max_episode_steps=-1)
            return Session(env)

        yield make


@pytest.mark.parametrize("name", EEF)
def test_every_action_follows_the_command_in_the_axes_of_world_and_tool(make, name):
    func, params = EEF[name]
    run = make(func, **params)
    seconds = run.env.step_dt
    run.step()
    start, turned = run.tool
    run.operator.set(linear=(0.0, 1.0, -0.5))
    run.step(20)
    run.operator.set(linear=(0.0, 0.0, 0.0))  # released: the tool stays where it is
    run.step(40)
    way = 0.25 * 20 * seconds * np.array([0.0, 1.0, -0.5])
    moved = run.tool[0] - start
    if "measured" in name:  # a motion from where the tool is: it is slower, as it is behind
        assert 0.2 < np.linalg.norm(moved) / np.linalg.norm(way) < 1
        way *= np.linalg.norm(moved) / np.linalg.norm(way)
    assert moved == pytest.approx(way, abs=5e-3)
    assert (run.tool[1] * turned.inv()).magnitude() < 0.01
    rest = run.tool[0]
    run.step(10)
    assert run.tool[0] == pytest.approx(rest, abs=1e-3)
    run.operator.set(axes="tool", angular=(0.0, 0.0, 1.0), linear=(1.0, 0.0, 0.0), speed=0.5)
    first = run.tool[1].as_matrix()[:, 0]
    run.step(10)
    run.operator.set(angular=(0.0, 0.0, 0.0), linear=(0.0, 0.0, 0.0))
    run.step(40)
    if "measured" in name:
        assert (run.tool[0] - rest) @ first > 0.01
        return
    angle = 0.5 * 10 * seconds
    wanted = turned * Rotation.from_rotvec([0.0, 0.0, angle])
    assert (run.tool[1] * wanted.inv()).magnitude() < 0.015
    assert (run.tool[0] - rest) @ first == pytest.approx(0.125 * 10 * seconds, abs=3e-3)


def test_the_tool_goes_to_where_it_is_dragged_and_no_faster_than_allowed(make):
    run = make("eef_delta_pose")
    run.step()
    start = run.tool[0]
    goal = start + np.array([0.05, -0.04, 0.03])
    run.operator.set(goal=tuple(goal))
    run.step()
    assert np.linalg.norm(run.tool[0] - start) <= 0.25 * run.env.step_dt + 1e-6
    run.step(60)
    assert run.tool[0] == pytest.approx(goal, abs=1e-3)


@pytest.fixture(scope="module")
def hands():
    env = embodichain.make("hand_over", num_envs=1, overrides=["seed=2"])
    yield env
    env.close()


def openings(env):
    """The gap of each gripper's fingers, m."""
    found = []
    for uid in ("right", "left"):
        robot = env.sim.robots[uid]
        one, other = (robot.get_link_pose(f"gripper/{side}_finger") for side in ("left", "right"))
        found.append(float((one[0, :3] - other[0, :3]).norm()))
    return np.array(found)


def test_grippers_and_arms_are_switched(hands):
    run = Session(hands)
    run.step(5)
    assert run.policy.tool_names == ["right_tool", "left_tool"]
    opened, right = openings(hands), run.tool[0]
    run.operator.set(switches=1, linear=(0.0, 0.0, 1.0))
    run.step(10)
    assert run.policy.active == 1 and run.policy.is_open
    run.operator.set(linear=(0.0, 0.0, 0.0), grips=1)
    run.step(20)
    assert not run.policy.is_open
    assert openings(hands)[1] < opened[1] - 0.05 and openings(hands)[0] == pytest.approx(opened[0])
    run.operator.set(switches=2, grips=3)  # twice is not at all
    run.step(20)
    assert run.policy.active == 0 and run.policy.is_open
    assert run.tool[0] == pytest.approx(right, abs=1e-3)  # the other arm did not move


def test_the_operator_ends_and_discards_episodes(hands):
    run = Session(hands)
    assert isinstance(run.policy, PlannedPolicy)
    run.step(2)
    assert not run.policy.done.any() and run.policy.failures == [None]
    run.operator.set(ends=1, grips=1)
    assert run.step()[0]
    assert run.policy.done.all() and run.policy.failures == [None]
    run.policy.reset(None)
    run.operator.set(ends=2, discards=1)  # pressed while there was nothing to be ended
    assert not run.step()[0]
    assert run.policy.is_open  # as every episode begins
    run.operator.set(discards=2)
    assert run.step()[0]
    assert run.policy.done.all() and run.policy.failures == [DISCARDED]
    assert run.operator.begun == 2


def test_what_cannot_be_teleoperated(make):
    with builder() as build:
        joints = ActionTermCfg(func="joint_position", params={"of": {"uid": "ur10"}})
        session = Session(build(num_envs=1, actions={"arm": joints}))
        with pytest.raises(ConfigError, match=r"operational_space; its actions are arm: joint_po"):
            session.step()
        tool = ActionTermCfg(func="eef_delta_pose", params={"of": {"uid": "ur10"}})
        with pytest.raises(ConfigError, match="set num_envs=1, not 2"):
            Session(build(num_envs=2, actions={"tool": tool})).step()
    alone = make("eef_delta_pose")
    alone.policy.operator = None
    with pytest.raises(ConfigError, match="teleop needs a viewer"):
        alone.step()
    with pytest.raises(ConfigError, match="linear_speed"):
        resolve_policy({"func": "teleop", "params": {"linear_speed": 0}})
