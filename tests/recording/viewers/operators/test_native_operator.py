"""Teleoperation in MuJoCo's window: keys, gamepad and dragged bodies, without a display."""

import numpy as np
import pytest

import embodichain
from embodichain.lab.gym.teleop import Teleop
from embodichain.recording.viewers.operators.native_operator import NativeOperator
from embodichain.utils.errors import ConfigError, EmbodichainError

pytestmark = pytest.mark.slow

UP, RIGHT, SPACE, ENTER, TURN, AXES = 265, 262, 32, 257, 324, 325


class Window:
    """In place of MuJoCo's window, which needs a display."""

    def __init__(self):
        self.on_key, self.is_running, self.dragged = None, True, None


@pytest.fixture(scope="module")
def env():
    made = embodichain.make("pick_place", num_envs=1, overrides=["seed=2"])
    yield made
    made.close()


class Session:
    """A run whose window, gamepad and keys are a test's."""

    def __init__(self, env):
        self.env, self.policy, self.window = env, Teleop(), Window()
        self.pad, self.stopped = None, False
        self.policy.bind(env)
        self.policy.operator = self.operator = NativeOperator(
            env, self.policy, lambda: self.stopped, lambda: self.pad, self.window
        )
        # No environment in real time: the operator's step would wait.
        self.operator._env = Quick(env)
        self.obs, _ = env.reset()
        self.policy._has_begun = True  # what begins an episode has a test of its own

    def step(self, count=1):
        for _ in range(count):
            action = self.policy(self.obs, self.env)
            self.obs, *_ = self.env.step(action)
        return action[0].numpy()

    @property
    def tool(self):
        return self.policy.tool_pose()[0]


class Quick:
    """An environment whose steps are not taken in real time."""

    def __init__(self, env):
        self.sim, self.step_dt = env.sim, env.step_dt


@pytest.fixture
def run(env, monkeypatch):
    # Time is that of the test's keys, not the clock's.
    monkeypatch.setattr(
        "embodichain.recording.viewers.operators.native_operator.time.sleep", lambda s: None
    )
    return Session(env)


def test_a_press_moves_the_tool_by_a_short_way(run):
    start = run.tool
    run.window.on_key(UP)
    run.step(20)
    assert run.tool - start == pytest.approx([0.02, 0.0, 0.0], abs=2e-3)
    for _ in range(10):  # no more than three presses are remembered
        run.window.on_key(RIGHT)
    run.step(40)
    assert run.tool - start == pytest.approx([0.02, -0.06, 0.0], abs=3e-3)
    assert run.step()[:6] == pytest.approx(0.0, abs=1e-6)  # it stays


def test_keys_of_the_keypad_turn_the_tool(run):
    run.window.on_key(TURN)
    action = run.step()
    assert action[5] > 0 and action[:5] == pytest.approx(0.0, abs=1e-6)
    turned = action[5] + sum(run.step()[5] for _ in range(10))
    assert turned * 0.1 == pytest.approx(np.deg2rad(5.0), abs=1e-4)


def test_the_gripper_and_the_end_of_an_episode(run):
    assert run.step()[6] == 1.0
    run.window.on_key(SPACE)
    assert run.step()[6] == -1.0
    run.window.on_key(ENTER)
    run.step()
    assert run.policy.done.all()


def test_a_gamepad_moves_the_tool_while_its_stick_is_held(run):
    run.pad = ([0.0, -1.0, 0.0, 0.0], [])
    assert run.step()[0] == pytest.approx(0.25 * run.env.step_dt / 0.02, abs=1e-5)
    run.pad = ([0.0, -1.0, 0.0, 0.0], [5])  # slow
    assert run.step()[0] == pytest.approx(0.05 * run.env.step_dt / 0.02, abs=1e-5)
    run.pad = ([0.0, 0.0, 0.0, 0.0], [0])
    assert run.step()[6] == -1.0
    assert run.step()[6] == -1.0  # held
    run.pad = None  # unplugged
    assert run.step()[:6] == pytest.approx(0.0, abs=1e-6)


def test_a_link_of_the_robot_is_dragged_and_other_bodies_are_not(run):
    way = np.array([0.03, 0.02, -0.04])
    cube = int(run.env.sim.rigid_objects["cube"].entity.body_ids[0])
    run.window.dragged = (cube, way)
    assert run.step()[:6] == pytest.approx(0.0, abs=1e-6)
    start = run.tool
    hand = int(run.env.sim.robots["robot"].entity.body_ids[-1])
    for _ in range(40):
        run.window.dragged = (hand, start + way - run.tool)  # the mouse stays where it is
        run.step()
    assert run.tool == pytest.approx(start + way, abs=2e-3)


def test_an_episode_begins_with_the_first_key(run, monkeypatch):
    naps = []

    def nap(seconds):
        naps.append(seconds)
        if len(naps) == 3:
            run.window.on_key(UP)

    monkeypatch.setattr("embodichain.recording.viewers.operators.native_operator.time.sleep", nap)
    run.window.on_key(RIGHT)  # before it begins: forgotten
    command = run.operator.command(True)
    assert len(naps) >= 3 and command.linear == (1.0, 0.0, 0.0)
    run.stopped = True
    run.operator.command(True)  # does not wait


def test_without_a_window_there_is_no_operator(env, run):
    with pytest.raises(ConfigError, match="use viewer=web"):
        NativeOperator(env, run.policy)
    run.window.is_running = False
    with pytest.raises(EmbodichainError, match="the window was closed"):
        run.step()
