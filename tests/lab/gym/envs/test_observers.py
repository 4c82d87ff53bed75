import numpy as np
import pytest

from embodichain.lab.gym.envs import StepObserver
from embodichain.lab.gym.envs.cfg import EventCfg
from tests.lab.gym.conftest import flat, home, jumping, targets


class Witness(StepObserver):
    def __init__(self):
        self.calls = []
        self.steps = []

    def on_reset(self, env, env_ids):
        self.calls.append(("reset", env_ids.tolist()))
        self.rows = env.sim.engine.rows.copy()

    def on_write(self, env, write):
        self.calls.append(("write", write.op, write.field))

    def on_physics(self, env, event):
        self.calls.append(("physics", event.phase, event.nstep))

    def on_event(self, env, event):
        ids = None if event.env_ids is None else event.env_ids.tolist()
        self.calls.append(("event", event.term, event.mode, ids))

    def on_step(self, env, step):
        self.calls.append(("step", step.control_step))
        self.steps.append(step)

    def on_close(self, env):
        self.calls.append(("close",))


def _kinds(calls):
    """The calls without writes, whose number is the scene's business."""
    return [call for call in calls if call[0] != "write"]


def test_an_observer_hears_a_step_in_order(make_env):
    env = make_env(**jumping(), max_episode_steps=2)
    witness = Witness()
    env.add_observer(witness)
    env.reset(seed=1)
    assert _kinds(witness.calls) == [("event", "place", "reset", None), ("reset", [0, 1, 2])]
    assert ("write", "state", "mocap_pos") in witness.calls
    env.step(targets(env, 0))
    env.reset(options={"env_ids": [0]})
    witness.calls.clear()
    env.step(targets(env, 1))
    assert _kinds(witness.calls) == [
        ("physics", "before", 4),
        ("physics", "after", 4),
        ("event", "move", "interval", [0]),  # the episodes of the others end
        ("event", "place", "reset", [1, 2]),
        ("reset", [1, 2]),
        ("step", 2),
    ]
    control = ("write", "state", "ctrl")
    assert witness.calls.index(control) < witness.calls.index(("physics", "before", 4))


def test_a_step_record_is_of_the_step_that_ended(make_env):
    env = make_env(max_episode_steps=2)
    witness = Witness()
    env.add_observer(witness)
    env.reset()
    actions = [targets(env, step) for step in range(3)]
    results = [env.step(action) for action in actions]
    assert [step.control_step for step in witness.steps] == [1, 2, 3]
    assert [step.episode_ids.tolist() for step in witness.steps] == [[0] * 3, [0] * 3, [1] * 3]
    for step, action, (obs, reward, terminated, truncated, info) in zip(
        witness.steps, actions, results, strict=True
    ):
        assert step.action.dtype == np.float64
        np.testing.assert_array_equal(step.action, action.numpy().astype(np.float64))
        np.testing.assert_array_equal(flat(step.obs), flat(obs))
        np.testing.assert_array_equal(step.reward, reward)
        assert step.truncated.tolist() == truncated.tolist()
        assert step.terminated.tolist() == terminated.tolist()
        assert step.info is info


def test_state_is_complete_when_a_reset_is_told(make_env):
    env = make_env(**jumping())
    witness = Witness()
    env.add_observer(witness)
    env.reset(seed=3)
    np.testing.assert_array_equal(witness.rows, env.sim.engine.rows)


def test_observing_changes_nothing(make_env):
    env, twin = (
        make_env(**jumping(), max_episode_steps=3),
        make_env(**jumping(), max_episode_steps=3),
    )
    env.add_observer(Witness())
    env.reset(seed=1), twin.reset(seed=1)
    for step in range(7):
        obs, expected = env.step(targets(env, step))[0], twin.step(targets(twin, step))[0]
        np.testing.assert_array_equal(flat(obs), flat(expected))


def test_a_removed_observer_hears_nothing(make_env):
    env = make_env(events={"quiet": EventCfg(func=lambda env, env_ids: None)})
    witness, other = Witness(), Witness()
    env.add_observer(witness), env.add_observer(other)
    env.reset()
    env.remove_observer(witness)
    witness.calls.clear()
    env.step(home(env))
    assert witness.calls == [] and ("step", 1) in other.calls
    env.remove_observer(other)
    assert env.sim.engine.listeners == []
    env.close()


def test_close_is_told_once(make_env):
    env = make_env()
    witness = Witness()
    env.add_observer(witness)
    env.close(), env.close()
    assert witness.calls == [("close",)]


def test_closing_goes_on_when_an_observer_raises(make_env):
    class Failing(Witness):
        def on_close(self, env):
            raise OSError("the disk is full")

    env = make_env()
    before, after = Witness(), Witness()
    for observer in (before, Failing(), after):
        env.add_observer(observer)
    with pytest.raises(OSError, match="the disk is full"):
        env.close()
    assert before.calls == after.calls == [("close",)]
    with pytest.raises(RuntimeError, match="destroy"):
        env.sim.engine.rows  # noqa: B018
    env.close()  # nothing is left to close
