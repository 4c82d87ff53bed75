"""What a step is judged by: the state, the command and the count of the step that was acted on."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import (
    CommandCfg,
    EventCfg,
    MetricCfg,
    NoiseCfg,
    ObservationCfg,
    PhysicsTaskCfg,
    RewardCfg,
    TerminationCfg,
)
from embodichain.lab.gym.envs.managers.term import Term
from tests.helpers.ur10_task import HOME, builder, task

CUBE = {"entity_cfg": {"uid": "cube"}}
GO = CommandCfg(
    "uniform_velocity",
    {**CUBE, "ranges": {"lin_vel_x": [0.5, 1.0]}},
    resampling_time_s=[0.09, 0.09],
)
PUSH = EventCfg(
    "push_by_setting_velocity",
    {**CUBE, "velocity_range": {"x": [1.0, 1.0]}},
    "interval",
    interval_range_s=[0.09, 0.09],
)
SPEED = ObservationCfg("linear_velocity", CUBE)
GIVEN = ObservationCfg("command", {"command_name": "go"})


@pytest.fixture
def make() -> Iterator[Any]:
    """Environments of 30 ms a step, without gravity: what is not pushed rests."""
    with builder() as build:
        yield lambda **sections: build(
            **{
                "physics": PhysicsTaskCfg(physics_dt=0.01, gravity=[0.0, 0.0, 0.0]),
                "sim_steps_per_control": 3,
                **sections,
            }
        )


def act(env: Any) -> torch.Tensor:
    return torch.tensor([HOME]).repeat(env.num_envs, 1)


def takes_obs(env, obs, action, info):
    """A term of EmbodiChain's signature: it gets the observation before judging."""
    assert obs is not None
    return torch.zeros(env.num_envs)


# -- commands and events ---------------------------------------------------------------------------


@pytest.mark.parametrize("with_obs", [False, True])
def test_a_step_is_judged_by_the_command_that_the_policy_saw(make, with_obs) -> None:
    """The cube rests: the error of its velocity is the command."""
    metrics = {"e": MetricCfg("linear_velocity_error", {**CUBE, "command_name": "go"}, shape="l2")}
    if with_obs:
        metrics["o"] = MetricCfg(takes_obs)
    env = make(commands={"go": GO}, observations={"go": GIVEN}, metrics=metrics)
    obs, _ = env.reset()
    commands = set()
    for step in range(1, 10):
        seen = obs["go"][:, 0]
        obs, *_, info = env.step(act(env))
        assert info["metrics"]["e"] == pytest.approx(seen**2, abs=1e-5)
        assert (obs["go"][:, 0] != seen).all() == (step % 3 == 0)
        assert torch.equal(obs["go"], env.command_manager.get_command("go"))
        commands.add(seen[0].item())
    assert len(commands) == 3


@pytest.mark.parametrize("with_obs", [False, True])
def test_a_push_is_observed_before_it_is_judged(make, with_obs) -> None:
    metrics = {"v": MetricCfg("linear_velocity", {**CUBE}, shape="l2")}
    if with_obs:
        metrics["o"] = MetricCfg(takes_obs)
    env = make(events={"p": PUSH}, observations={"v": SPEED}, metrics=metrics)
    env.reset()
    for step in range(1, 5):
        obs, *_, info = env.step(act(env))
        if step < 3:
            assert obs["v"][:, 0].abs().max() < 1e-6
        if step == 3:
            assert info["metrics"]["v"].max() < 1e-6
            assert obs["v"][:, 0] == pytest.approx(1.0, abs=1e-6)
    assert info["metrics"]["v"].min() > 0.5


def test_the_tracking_error_of_a_command_is_that_of_the_command_acted_on(make) -> None:
    """After two commands of three steps, the mean error is that of both, three times each."""
    env = make(commands={"go": GO}, observations={"go": GIVEN})
    obs, _ = env.reset()
    errors = []
    for _ in range(6):
        errors.append(obs["go"][:, 0])
        obs, *_, info = env.step(act(env))
    assert len({tuple(error.tolist()) for error in errors}) == 2
    mean = torch.stack(errors).mean(0).numpy()
    assert info["metrics"]["go/error_vel_xy"].numpy() == pytest.approx(mean, abs=1e-4)


def test_environments_that_end_are_neither_pushed_nor_given_a_command(make) -> None:
    """All are due in step 3, in which environment 1 ends: its last observation is as it was."""

    def ends(env, obs, action, info):
        return (info["elapsed_steps"] == 3) & (torch.arange(env.num_envs) == 1)

    env = make(
        commands={"go": GO},
        events={"p": PUSH},
        observations={"go": GIVEN, "v": SPEED},
        terminations={"t": TerminationCfg(ends)},
    )
    first, _ = env.reset()
    for _ in range(3):
        obs, _, terminated, _, info = env.step(act(env))
    assert terminated.tolist() == [False, True, False]
    final = info["final_obs"]
    assert (final["go"][:, 0] == first["go"][:, 0]).tolist() == [False, True, False]
    assert (final["v"][:, 0] > 0.5).tolist() == [True, False, True]
    assert torch.equal(final["go"][[0, 2]], obs["go"][[0, 2]])


def test_events_that_watch_see_the_last_step(make) -> None:
    """And what they see is not observed once more."""
    seen: dict[str, list[Any]] = {"watching": [], "acting": []}

    class Watching(Term):
        watches = True

        def __init__(self, env) -> None:
            pass

        def __call__(self, env, env_ids) -> None:
            seen["watching"].append(None if env_ids is None else env_ids.tolist())

    def acting(env, env_ids) -> None:
        seen["acting"].append(None if env_ids is None else env_ids.tolist())

    def ends(env, obs, action, info):
        return torch.arange(env.num_envs) == 1

    each = {"mode": "interval", "interval_step": 1}
    env = make(
        events={"w": EventCfg(Watching, **each), "a": EventCfg(acting, **each)},
        terminations={"t": TerminationCfg(ends)},
    )
    env.reset()
    env.step(act(env))
    assert seen == {"watching": [None], "acting": [[0, 2]]}
    alone = make(events={"w": EventCfg(Watching, **each)})
    assert not alone.event_manager.acts_in_steps


def test_events_of_all_environments_fire_whoever_ends(make) -> None:
    fired = []
    env = make(
        events={
            "g": EventCfg(
                lambda env, ids: fired.append(ids), mode="interval", interval_step=2, is_global=True
            )
        },
        max_episode_steps=2,
    )
    env.reset()
    for _ in range(4):
        env.step(act(env))
    assert fired == [None, None]


@pytest.mark.parametrize("mode", ["NEXT_STEP", "DISABLED"])
def test_other_autoreset_modes(mode) -> None:
    """Environments that ended are not pushed: not in the step that resets them either."""
    cfg = task(
        physics=PhysicsTaskCfg(physics_dt=0.01, gravity=[0.0, 0.0, 0.0]),
        sim_steps_per_control=3,
        events={"p": EventCfg(PUSH.func, PUSH.params, "interval", interval_step=3)},
        observations={"v": SPEED},
        max_episode_steps=3,
    )
    with BaseEnv(cfg, autoreset_mode=mode) as env:
        env.reset()
        for _ in range(3):
            obs, _, _, truncated, _ = env.step(act(env))
        assert truncated.all() and obs["v"].abs().max() < 1e-6
        obs = env.step(act(env))[0]
        assert obs["v"].abs().max() < 1e-6


# -- the observation that is taken before judging --------------------------------------------------

NOISY = {
    "v": ObservationCfg("linear_velocity", CUBE, noise=NoiseCfg(std=0.1), history_length=3),
    "late": ObservationCfg("linear_velocity", CUBE, delay=[0, 2]),
    "rate": ObservationCfg("linear_velocity", CUBE, shape={"rate": "step"}),
    "go": ObservationCfg("command", {"command_name": "go"}, noise=NoiseCfg(std=0.1)),
    "n": ObservationCfg("elapsed_fraction", noise=NoiseCfg(std=0.1), delay=1, history_length=2),
}
DUE = {
    "commands": {
        "go": CommandCfg(GO.func, GO.params, resampling_time_s=[0.06, 0.2]),
    },
    "events": {
        "p": EventCfg(PUSH.func, PUSH.params, "interval", interval_range_s=[0.06, 0.2]),
    },
    "observations": NOISY,
    "max_episode_steps": 7,
}


def rows(env: Any, steps: int) -> np.ndarray:
    obs, _ = env.reset()
    found = [obs.rows]
    for _ in range(steps):
        obs, *_, info = env.step(act(env))
        found += [obs.rows, info["final_obs"].rows] if "final_obs" in info else [obs.rows]
    return np.stack(found)


def test_observing_before_judging_changes_no_observation(make) -> None:
    """Noise, delay, history and terms with a state advance once in a step observed twice."""
    plain = rows(make(**DUE), 20)
    assert (rows(make(**DUE, rewards={"o": RewardCfg(takes_obs)}), 20) == plain).all()


def test_environments_observed_once_more_do_not_depend_on_their_number(make) -> None:
    judged = {**DUE, "rewards": {"o": RewardCfg(takes_obs)}}
    few, many = make(**judged, num_envs=2), make(**judged, num_envs=5)
    assert (rows(few, 20) == rows(many, 20)[:, :2]).all()


def test_a_saved_environment_goes_on_with_the_same_observations(make) -> None:
    judged = {**DUE, "rewards": {"o": RewardCfg(takes_obs)}}
    env, other = make(**judged), make(**judged)
    rows(env, 4)
    other.reset()
    other.load_state_dict(env.state_dict())
    for _ in range(12):
        assert (env.step(act(env))[0].rows == other.step(act(other))[0].rows).all()


def test_a_reward_that_takes_the_observation_gets_that_of_the_judged_state(make) -> None:
    seen = []

    def look(env, obs, action, info):
        seen.append(obs["v"][:, 0].clone())
        return torch.zeros(env.num_envs)

    env = make(events={"p": PUSH}, observations={"v": SPEED}, rewards={"r": RewardCfg(look)})
    env.reset()
    seen.clear()
    for _ in range(3):
        obs = env.step(act(env))[0]
    assert seen[2].abs().max() < 1e-6
    assert obs["v"][:, 0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("inner", [takes_obs, "linear_velocity"])
def test_only_terms_that_take_the_observation_are_given_one(make, inner) -> None:
    """A joined term takes it if one of its terms does."""
    shape = None if callable(inner) else "l2"
    term = MetricCfg(inner, {} if callable(inner) else CUBE, shape=shape)
    joined = {"terms": {"a": MetricCfg("height", CUBE), "b": term}}
    env = make(observations={"v": SPEED}, metrics={"m": MetricCfg("all_of", joined)})
    # Whether a step observes once more is a matter of time only: no result tells it.
    assert env._judge.obs_is_needed == callable(inner)


# -- the count of steps ----------------------------------------------------------------------------


def test_every_term_counts_the_present_step(make) -> None:
    """0 after a reset, then 1, 2, ...; hooks of a class count as EmbodiChain does."""
    seen: dict[str, list[int]] = {}

    def note(name, env):
        seen.setdefault(name, []).append(int(env.elapsed_steps[0]))

    def observed(env, obs):
        note("observation", env)
        return env.elapsed_steps.float()[:, None]

    def judged(name):
        def term(env, obs, action, info):
            note(name, env)
            return torch.zeros(env.num_envs)

        return term

    class Hooked(BaseEnv):
        def _extend_obs(self, obs, **kwargs):
            note("_extend_obs", self)
            return obs

        def evaluate(self, **kwargs):
            note("evaluate", self)
            return {}

        def get_reward(self, obs, action, info):
            note("get_reward", self)
            assert info["elapsed_steps"][0] == self.elapsed_steps[0]
            return torch.zeros(self.num_envs)

        def check_truncated(self, obs, info):
            note("check_truncated", self)
            return torch.zeros(self.num_envs, dtype=torch.bool)

    cfg = task(
        observations={"t": ObservationCfg(observed)},
        rewards={"r": RewardCfg(judged("reward"))},
        terminations={"e": TerminationCfg(judged("termination"))},
        metrics={"m": MetricCfg(judged("metric"))},
        events={
            "i": EventCfg(lambda env, ids: note("event", env), mode="interval", interval_step=2)
        },
        max_episode_steps=4,
    )
    with Hooked(cfg) as env:
        env.reset()
        seen.clear()
        clocks = []
        for _ in range(4):
            obs, *_, info = env.step(act(env))
            clocks.append(info.get("final_obs", obs)["t"][0].item())
    assert clocks == [1, 2, 3, 4]
    assert obs["t"][0].item() == 0
    for name in ("reward", "termination", "metric", "check_truncated"):
        assert seen[name] == [1, 2, 3, 4]
    assert seen["event"] == [2]
    # Step 2 is observed once more after the event; the last one is the reset's.
    assert seen["observation"] == [1, 2, 2, 3, 4, 0]
    assert seen["_extend_obs"] == [0, 1, 1, 2, 3, 0]
    assert seen["evaluate"] == seen["get_reward"] == [0, 1, 2, 3]
