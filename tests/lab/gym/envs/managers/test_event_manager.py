"""When events fire, for whom, and what they draw."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.utils.errors import ConfigError


class Fired(StepObserver):
    def __init__(self) -> None:
        self.events = []

    def on_event(self, env, event) -> None:
        self.events.append(event)


def note(env, env_ids) -> None:
    """Does nothing; observers hear of it."""


def draw(env, env_ids) -> None:
    env.event_manager.draw("x", (2,), 0.0, 1.0, env_ids)


def watch(env) -> Fired:
    fired = Fired()
    env.add_observer(fired)
    return fired


def steps(env, count: int) -> None:
    action = torch.from_numpy(env.action_space.sample() * 0)
    for _ in range(count):
        env.step(action)


def ids_of(fired: Fired, term: str) -> list:
    return [
        None if e.env_ids is None else e.env_ids.tolist() for e in fired.events if e.term == term
    ]


def test_startup_fires_once(make) -> None:
    calls = []
    env = make(events={"s": EventCfg(func=lambda env, ids: calls.append(ids), mode="startup")})
    env.reset()
    env.reset()
    env.event_manager.apply("startup")
    assert calls == [None]


def test_reset_events_get_the_environments(make) -> None:
    env = make(events={"r": EventCfg(func=note, mode="reset")})
    fired = watch(env)
    env.reset()
    env.reset(options={"reset_ids": [0, 2]})
    assert ids_of(fired, "r") == [None, [0, 2]]
    assert [e.mode for e in fired.events] == ["reset", "reset"]


def test_every_step_fires_for_all_without_indices(make) -> None:
    env = make(events={"i": EventCfg(func=note, mode="interval", interval_step=1)})
    env.reset()
    fired = watch(env)
    steps(env, 3)
    assert ids_of(fired, "i") == [None, None, None]


def test_interval_counts_per_environment_and_restarts_at_reset(make) -> None:
    env = make(events={"i": EventCfg(func=note, mode="interval", interval_step=3)})
    env.reset()
    fired = watch(env)
    steps(env, 2)
    env.reset(options={"reset_ids": [1]})
    steps(env, 1)
    assert ids_of(fired, "i") == [[0, 2]]
    steps(env, 2)
    assert ids_of(fired, "i") == [[0, 2], [1]]
    steps(env, 1)
    assert ids_of(fired, "i") == [[0, 2], [1], [0, 2]]


def test_an_automatic_reset_restarts_the_count_too(make) -> None:
    env = make(
        max_episode_steps=4, events={"i": EventCfg(func=note, mode="interval", interval_step=3)}
    )
    env.reset()
    fired = watch(env)
    steps(env, 6)
    assert ids_of(fired, "i") == [None]  # at step 3; the reset after step 4 starts again
    steps(env, 1)
    assert ids_of(fired, "i") == [None, None]


def test_a_global_interval_runs_through_resets(make) -> None:
    env = make(events={"g": EventCfg(func=note, mode="interval", interval_step=3, is_global=True)})
    env.reset()
    fired = watch(env)
    steps(env, 2)
    env.reset()
    steps(env, 1)
    assert ids_of(fired, "g") == [None]
    env.reset(seed=1)
    steps(env, 2)
    assert len(fired.events) == 1
    steps(env, 1)
    assert len(fired.events) == 2


def test_interval_range_is_drawn_per_environment(make) -> None:
    event = EventCfg(func=note, mode="interval", interval_range_s=[0.04, 0.4])
    env = make(
        num_envs=16, max_episode_steps=-1, events={"i": event}
    )  # a control step is 0.04 s: 1 to 10 steps
    env.reset()
    fired = watch(env)
    times = [[] for _ in range(16)]
    for step in range(1, 61):
        before = len(fired.events)
        steps(env, 1)
        for event_record in fired.events[before:]:
            where = range(16) if event_record.env_ids is None else event_record.env_ids
            for i in where:
                times[i].append(step)
    gaps = np.concatenate([np.diff(t[:5]) for t in times])
    assert gaps.min() >= 1 and gaps.max() <= 10
    assert len(set(gaps.tolist())) >= 7
    assert len({tuple(t[:5]) for t in times}) > 12


def test_each_term_draws_from_its_own_stream(make) -> None:
    def drawn(*names) -> dict[str, np.ndarray]:
        env = make(events={name: EventCfg(func=draw, mode="reset") for name in names})
        fired = watch(env)
        env.reset(seed=3)
        return {e.term: e.drawn["x"] for e in fired.events}

    both, alone = drawn("a", "b"), drawn("b")
    assert np.array_equal(both["b"], alone["b"])
    assert not np.array_equal(both["a"], both["b"])
    assert both["a"].shape == (3, 2)
    assert len(np.unique(both["a"])) == 6


def test_a_class_is_built_once_and_reset(make) -> None:
    log = []

    class Counter:
        def __init__(self, env, start: int = 5) -> None:
            log.append(("built", start))

        def __call__(self, env, env_ids) -> None:
            log.append(("called", env_ids))

        def reset(self, env_ids) -> None:
            log.append(("reset", None if env_ids is None else env_ids.tolist()))

    env = make(events={"c": EventCfg(func=Counter, params={"start": 2}, mode="reset")})
    env.reset()
    assert log == [("built", 2), ("reset", None), ("called", None)]
    env.reset(options={"reset_ids": [1]})
    assert log[3] == ("reset", [1])


def test_state_is_restored(make) -> None:
    event = EventCfg(func=draw, mode="interval", interval_range_s=[0.04, 0.4])
    env = make(events={"i": event})
    env.reset()
    steps(env, 2)
    state, streams = env.event_manager.state_dict(), env.streams.state_dict()
    fired = watch(env)
    steps(env, 20)
    first = [(e.env_ids, e.drawn["x"].tolist()) for e in fired.events]
    env.event_manager.load_state_dict(state)
    env.streams.load_state_dict(streams)
    fired.events.clear()
    steps(env, 20)
    again = [(e.env_ids, e.drawn["x"].tolist()) for e in fired.events]
    assert len(first) > 3
    assert str(first) == str(again)


@pytest.mark.parametrize("has_wrong_type", [False, True])
def test_all_mistakes_come_at_once_with_their_paths(make, has_wrong_type: bool) -> None:
    interval = [2.0, 1.0] if has_wrong_type else [1.0, 2.0]
    with pytest.raises(ConfigError) as caught:
        make(
            events={
                "a": EventCfg(func="randomize_rigid_object_pose"),
                "b": EventCfg(
                    func="randomize_rigid_object_pose",
                    params={"entity_cfg": {"uid": "cub"}, "relative_to": {"uid": "ur10"}},
                ),
                "c": EventCfg(
                    func="randomize_rigid_object_pose", params={"entity_cfg": {"uid": "ur10"}}
                ),
                "d": EventCfg(func=note, mode="interval", interval_range_s=interval),
            }
        )
    paths = [p.path for p in caught.value.problems]
    expected = ["events.a.params.of", "events.b.params.entity_cfg.uid"]
    # That ur10 is not an object shows when terms are built, which needs values of right types.
    expected.append(
        "events.d.interval_range_s" if has_wrong_type else "events.c.params.entity_cfg.uid"
    )
    assert sorted(paths) == expected
