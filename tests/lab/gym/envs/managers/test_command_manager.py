"""Commands: drawn at resets and on time, for each environment alone, seen by terms and the log."""

from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import CommandCfg, ObservationCfg, RewardCfg
from embodichain.lab.gym.envs.managers.term import CommandTerm
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME

BOX = [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]
ROBOT = {"entity_cfg": {"uid": "ur10"}}


def pose(**fields: Any) -> CommandCfg:
    params = {**ROBOT, "position_range": BOX, **fields.pop("params", {})}
    return CommandCfg(func="uniform_pose", params=params, **fields)


def home(env: Any) -> torch.Tensor:
    return torch.tensor([HOME]).repeat(env.num_envs, 1)


def test_commands_are_drawn_at_resets_within_their_ranges(make) -> None:
    env = make(commands={"goal": pose()}, num_envs=64)
    env.reset()
    values = env.command_manager.values("goal")
    assert values.shape == (64, 7)
    assert ((values[:, :3] >= BOX[0]) & (values[:, :3] < BOX[1])).all()
    assert len(np.unique(values[:, 0])) == 64
    assert (values[:, 3:] == [1, 0, 0, 0]).all()
    assert env.command_manager.names("goal")[:3] == ("x", "y", "z")
    command = env.command_manager.get_command("goal")
    assert (command.dtype, tuple(command.shape)) == (torch.float32, (64, 7))


def test_a_reset_of_one_environment_moves_no_other(make) -> None:
    env = make(commands={"goal": pose(resampling_time_s=[0.1, 0.4])})
    env.reset()
    before = env.command_manager.values("goal").copy()
    env.reset(options={"reset_ids": [1]})
    after = env.command_manager.values("goal")
    assert (after[[0, 2]] == before[[0, 2]]).all()
    assert (after[1, :3] != before[1, :3]).all()


def test_without_a_time_a_command_lasts_for_the_episode(make) -> None:
    env = make(commands={"goal": pose()})
    env.reset()
    before = env.command_manager.values("goal").copy()
    for _ in range(5):
        env.step(home(env))
    assert (env.command_manager.values("goal") == before).all()


def test_a_command_is_drawn_anew_when_its_time_is_over(make) -> None:
    env = make(commands={"goal": pose(resampling_time_s=[0.12, 0.12])})
    env.reset()
    changes, last = [], env.command_manager.values("goal").copy()
    for _ in range(9):  # a step is 0.04 s
        env.step(home(env))
        now = env.command_manager.values("goal").copy()
        changes.append(bool((now != last).any()))
        last = now
    assert changes == [False, False, True] * 3


def history(make, num_envs: int, steps: int = 12) -> np.ndarray:
    env = make(
        commands={
            "a": pose(resampling_time_s=[0.04, 0.2]),
            "b": CommandCfg(func="uniform_joint_position", params=ROBOT),
        },
        num_envs=num_envs,
    )
    env.reset()
    found = []
    for step in range(steps):
        env.step(home(env))
        if step == 5:
            env.reset(options={"reset_ids": [0]})
        manager = env.command_manager
        found.append(np.concatenate([manager.values("a"), manager.values("b")], axis=1))
    return np.stack(found, axis=1)


def test_what_an_environment_is_commanded_does_not_depend_on_their_number(make) -> None:
    alone, few, many = (history(make, n) for n in (1, 3, 64))
    assert alone.tobytes() == few[:1].tobytes()
    assert few.tobytes() == many[:3].tobytes()


def test_a_saved_environment_continues_to_the_bit(make) -> None:
    commands = {"a": pose(resampling_time_s=[0.04, 0.3])}
    env = make(commands=commands)
    env.reset()
    for _ in range(3):
        env.step(home(env))
    saved = env.state_dict()
    wanted = []
    for _ in range(8):
        env.step(home(env))
        wanted.append(env.command_manager.values("a").copy())
    other = make(commands=commands)
    other.reset(seed=99)
    other.load_state_dict(saved)
    for values in wanted:
        other.step(home(other))
        assert (other.command_manager.values("a") == values).all()


def test_observers_hear_what_was_drawn(make) -> None:
    class Ear(StepObserver):
        def __init__(self) -> None:
            self.heard: list[Any] = []

        def on_event(self, env, event) -> None:
            self.heard.append(event)

    env, ear = make(commands={"goal": pose()}), Ear()
    env.add_observer(ear)
    env.reset(options={"reset_ids": [2]})
    (event,) = ear.heard
    assert (event.term, event.mode, event.env_ids.tolist()) == ("goal", "command", [2])
    assert (event.drawn["pose"][0, :3] == env.command_manager.values("goal")[2, :3]).all()


class Follow(CommandTerm):
    """Counts what is called for whom."""

    names = ("x",)

    def __init__(self, env) -> None:
        self.values = np.zeros((env.num_envs, 1))
        self.calls: list[Any] = []

    def resample(self, env_ids) -> None:
        self.values[slice(None) if env_ids is None else env_ids] = 5.0

    def update(self, env_ids) -> None:
        self.calls.append(None if env_ids is None else env_ids.tolist())

    def metrics(self):
        return {"error": self.values[:, 0] * np.arange(1, len(self.values) + 1)}


def test_updates_follow_draws_and_steps(make) -> None:
    env = make(commands={"f": CommandCfg(func=Follow)})
    env.reset()
    env.step(home(env))
    env.reset(options={"reset_ids": [1]})
    assert env.command_manager.terms["f"].instance.calls == [None, None, [1]]


def test_metrics_are_means_over_the_episode(make) -> None:
    env = make(commands={"f": CommandCfg(func=Follow)})
    env.reset()
    env.step(home(env))
    env.command_manager.terms["f"].instance.values[:] = 7.0
    info = env.step(home(env))[4]
    assert info["metrics"]["f/error"].tolist() == [6.0, 12.0, 18.0]
    env.reset(options={"reset_ids": [0]})
    info = env.step(home(env))[4]
    assert info["metrics"]["f/error"].tolist() == pytest.approx([5.0, 38 / 3, 19.0])


def test_an_observation_of_a_command(make) -> None:
    env = make(
        commands={"goal": pose()},
        observations={
            "c": ObservationCfg(func="generated_command", params={"command_name": "goal"})
        },
    )
    obs, _ = env.reset()
    assert torch.equal(obs["c"], env.command_manager.get_command("goal"))


def test_an_unknown_command_is_an_error_that_lists_them(make) -> None:
    with pytest.raises(ConfigError) as caught:
        make(
            commands={"goal": pose()},
            observations={
                "c": ObservationCfg(func="generated_command", params={"command_name": "gaol"})
            },
        )
    (problem,) = caught.value.problems
    assert problem.path == "observations.c.params.command_name"
    assert "there are: goal" in problem.message
    assert problem.hint == "Did you mean 'goal'?"


def test_a_reward_sees_the_command_that_was_acted_on(make) -> None:
    seen = []

    def near(env, obs, action, info):
        seen.append(env.command_manager.values("goal").copy())
        return torch.zeros(env.num_envs)

    env = make(
        commands={"goal": pose(resampling_time_s=[0.04, 0.04])},
        rewards={"near": RewardCfg(func=near)},
    )
    env.reset()
    seen.clear()
    given = env.command_manager.values("goal").copy()
    env.step(home(env))
    assert (seen[-1] == given).all()
    assert (env.command_manager.values("goal") != given).any()


class Shapeless(CommandTerm):
    def __init__(self, env) -> None:
        self.values = np.zeros(env.num_envs)


def test_a_command_without_a_matrix_is_refused(make) -> None:
    with pytest.raises(ConfigError, match=r"commands\.f\.func: .* must set values"):
        make(commands={"f": CommandCfg(func=Shapeless)})
    with pytest.raises(ConfigError, match="must be a subclass of CommandTerm"):
        make(commands={"f": CommandCfg(func=lambda env: None)})
