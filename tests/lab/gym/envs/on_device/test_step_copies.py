"""Observers of arrays on the device: they see copies, as observers of the host see its arrays."""

import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.envs import StepObserver
from embodichain.lab.sim.engine.device.device_array import HostTransferError
from embodichain.utils.errors import ConfigError
from tests.helpers.warp_scene import RANDOMIZED

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N, STEPS = 4, 18


class Notes(StepObserver):
    """Copies of all that an observer is told."""

    may_lag = True

    def __init__(self):
        self.found, self.fields, self.closed = [], [], 0

    def on_reset(self, env, env_ids):
        self.found.append(("reset", env_ids.tolist()))

    def on_write(self, env, write):
        if write.op == "reset":
            ids = range(env.num_envs) if write.env_ids is None else write.env_ids.tolist()
            self.found.append(("reset begins", list(ids)))

    def on_physics(self, env, event):
        engine = env.sim.engine
        assert event.rows is engine.rows and event.rows.dtype == np.float64
        self.found.append((event.phase, event.nstep, event.rows.copy()))
        if event.phase == "before":
            self.fields.append(engine.model_fields())

    def on_event(self, env, event):
        ids = None if event.env_ids is None else event.env_ids.tolist()
        self.found.append(("event", event.term, event.mode, ids, dict(event.drawn)))

    def on_step(self, env, step):
        assert {type(part) for part in step[1:5]} == {np.ndarray}
        ended = {name: np.asarray(v) for name, v in env.termination_manager.values.items()}
        groups = [{k: np.asarray(v) for k, v in step.info[g].items()} for g in GROUPS]
        flags = {name: np.asarray(step.info[name]) for name in FLAGS}
        weights = dict(env.reward_manager.weights)
        results = {name: np.array(getattr(step, name)) for name in RESULTS}
        self.found.append(("step", step.control_step, results, groups, flags, ended, weights))

    def on_close(self, env):
        self.closed += 1


GROUPS = ("rewards", "episode_sums", "metrics")
FLAGS = ("success", "fail", "diverged", "elapsed_steps")
RESULTS = ("action", "reward", "terminated", "truncated", "episode_ids")


def played(arrays):
    """The notes of an observer; with resets of some environments, and a write between steps."""
    rng, notes = np.random.default_rng(0), Notes()
    with embodichain.make("cart_pole", N, [*RANDOMIZED, f"sim.warp.arrays={arrays}"]) as env:
        env.add_observer(notes)
        env.reset()
        for step in range(STEPS):
            if step == 4:
                env.reset(options={"reset_ids": [1]})
            if step == 6:
                env.truncate([3])
            if step == 9:
                env.robot.set_qpos(np.full((1, 2), 0.05), env_ids=[2], target=False)
            action = rng.uniform(-1, 1, (N, 1)).astype(np.float32)
            env.step(torch.from_numpy(action).to(env.device))
    assert notes.closed == 1
    return notes


@pytest.fixture(scope="module")
def both():
    return played("device"), played("host")


def close(a, b, where):
    """Compare what two observers were told, up to the rounding of float32."""
    assert type(a) is type(b), where
    if isinstance(a, dict):
        assert a.keys() == b.keys(), where
        a, b = list(a.values()), list(b.values())
    if isinstance(a, (list, tuple)):
        assert len(a) == len(b), where
        for x, y in zip(a, b, strict=True):
            close(x, y, where)
    elif isinstance(a, np.ndarray):
        assert a.shape == b.shape, where
        np.testing.assert_allclose(a.astype(float), b.astype(float), atol=2e-6, err_msg=str(where))
    else:
        assert a == b, where


def test_an_observer_is_told_the_same_as_on_the_host(both):
    """In the same order: draws before the reset's end, physics, results of steps."""
    device, host = (notes.found for notes in both)
    kinds = [[entry[0] for entry in notes] for notes in (device, host)]
    assert kinds[0] == kinds[1] and kinds[0].count("step") == STEPS
    resets = [entry[1] for entry in device if entry[0] == "reset"]
    assert resets[:3] == [[0, 1, 2, 3], [1], [0, 2, 3]] and len(resets) > 3
    for number, (a, b) in enumerate(zip(device, host, strict=True)):
        close(a, b, (number, *a[:2]))


def test_model_fields_are_those_of_each_episode(both):
    device, host = both
    assert len(device.fields) == len(host.fields) == STEPS
    drawn = set()
    for found, wanted in zip(device.fields, host.fields, strict=True):
        assert {"body_mass", "opt.gravity"} <= found.keys()
        for name, values in found.items():
            # On a device a field is one of each environment before any is drawn.
            other = wanted.get(name, values[:1])
            scale = max(1.0, np.abs(other).max())
            np.testing.assert_allclose(values, other + 0 * values, atol=2e-5 * scale, err_msg=name)
        drawn |= set(found["body_mass"].sum(axis=1).tolist())
    assert len(drawn) > 6


@pytest.fixture
def env():
    lines = [line for line in RANDOMIZED if not line.startswith("+")]
    with embodichain.make("cart_pole", N, [*lines, "sim.warp.arrays=device"]) as env:
        yield env


def test_what_needs_the_device_is_refused(env):
    with pytest.raises(
        ConfigError, match="observers that may not be called late are not available"
    ):
        env.add_observer(StepObserver())
    assert env.copies is None
    engine = env.observed.sim.engine
    for use in (
        lambda: engine.step(1),
        lambda: engine.forward(),
        lambda: engine.derived("xpos"),
        lambda: engine.acceleration("qfrc_actuator"),
        lambda: engine.cast_rays(np.zeros((1, 1, 3)), np.ones((1, 1, 3)), np.ones(1, bool)),
    ):
        with pytest.raises(HostTransferError, match="a copy of states has not"):
            use()
    assert env.observed.sim.sensors == {} and env.observed.step_dt == env.step_dt


def test_a_step_that_fails_is_not_told(env, monkeypatch):
    notes = Notes()
    env.add_observer(notes)
    env.reset()
    zero = torch.zeros(N, 1, device=env.device)
    env.step(zero)
    compute = env.reward_manager.compute

    def fails(*args):
        monkeypatch.setattr(env.reward_manager, "compute", compute)
        raise RuntimeError("no reward")

    # A step that fails once, in its middle.
    monkeypatch.setattr(env.reward_manager, "compute", fails)
    with pytest.raises(RuntimeError, match="no reward"):
        env.step(zero)
    env.step(zero)
    env.copies.flush()
    assert [entry[0] for entry in notes.found].count("step") == 2
    physics = [entry for entry in notes.found if entry[0] in ("before", "after")]
    assert [entry[0] for entry in physics] == ["before", "after"] * 2
    # The state before the last step is that of the step that failed; it is known.
    assert not np.array_equal(physics[2][2], physics[1][2])
    np.testing.assert_array_equal(physics[-1][2], env.sim.engine.host_rows())


def test_observers_can_come_and_go(env):
    """Without observers nothing is copied; later ones begin with the state of that moment."""
    first, second = Notes(), Notes()
    env.add_observer(first)
    env.reset()
    zero = torch.zeros(N, 1, device=env.device)
    env.step(zero)
    revision = env.revision
    env.add_observer(second)
    env.remove_observer(first)
    env.step(zero)
    assert [len([e for e in n.found if e[0] == "step"]) for n in (first, second)] == [1, 1]
    env.remove_observer(second)
    assert env.copies is None and env.observers == [] == env.sim.engine.listeners
    assert env.revision != revision
    env.step(zero)
    third = Notes()
    env.add_observer(third)
    np.testing.assert_array_equal(env.observed.sim.engine.rows, env.sim.engine.host_rows())
    env.step(zero)
    assert [entry[:2] for entry in third.found if entry[0] == "step"] == [("step", 4)]
    with pytest.raises(ValueError):
        env.remove_observer(first)


def test_commands_are_copied():
    lines = [line for line in RANDOMIZED if not line.startswith(("+", "sim.warp.n"))]
    sizes = ["sim.warp.nconmax=64", "sim.warp.njmax=128", "sim.warp.arrays=device"]
    with embodichain.make("quadruped_velocity", 3, [*lines, *sizes]) as env:
        env.add_observer(Notes())
        seen = env.observed.command_manager.terms["velocity"].instance
        before = seen.values.copy()
        env.reset()
        assert (seen.values != before).any()
        zero = torch.zeros(3, *env.single_action_space.shape, device=env.device)
        for _ in range(8):
            env.step(zero)
        env.copies.flush()
        now = env.command_manager.terms["velocity"].instance.values.host()
        np.testing.assert_array_equal(seen.values, now.astype(np.float64))
        assert seen.names == env.command_manager.terms["velocity"].instance.names
