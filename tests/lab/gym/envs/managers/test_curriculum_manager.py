"""Curricula: called before resets, timed by control steps, undone and restored exactly."""

from typing import Any

import pytest
import torch

from embodichain.lab.gym.envs.cfg import (
    CommandCfg,
    CurriculumCfg,
    EventCfg,
    ObservationCfg,
    RewardCfg,
    TerminationCfg,
)
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME


def act(env: Any) -> torch.Tensor:
    return torch.tensor([HOME]).repeat(env.num_envs, 1)


def one(env, obs, action, info):
    return torch.ones(env.num_envs)


def amount(env, obs, action, info, size: float = 1.0, pair: Any = (0.0, 0.0)):
    return torch.full((env.num_envs,), size + sum(pair))


def weight(**params: Any) -> dict[str, Any]:
    given = {"term_name": "r", "weight": 5.0, "num_steps": 4, **params}
    return {
        "rewards": {"r": RewardCfg(func=one, weight=2.0)},
        "curriculum": {"c": CurriculumCfg(func="modify_reward_weight", params=given)},
        "max_episode_steps": 2,
    }


def rewards(env: Any, steps: int) -> list[float]:
    return [env.step(act(env))[1][0].item() for _ in range(steps)]


def test_a_weight_changes_at_the_first_reset_after_its_time(make) -> None:
    env = make(**weight())
    env.reset()
    assert rewards(env, 8) == [2.0] * 4 + [5.0] * 4
    env = make(**weight(num_steps=5))
    env.reset()
    assert rewards(env, 8) == [2.0] * 6 + [5.0] * 2


def test_a_weight_goes_in_a_line(make) -> None:
    env = make(**weight(num_steps=8, start_step=4, interpolate=True))
    env.reset()
    assert rewards(env, 10) == [2.0] * 6 + [3.5] * 2 + [5.0] * 2


def test_values_are_in_info_as_they_stood_in_the_step(make) -> None:
    env = make(**weight())
    env.reset()
    infos = [env.step(act(env))[4]["curriculum"] for _ in range(5)]
    assert infos == [{"c": 2.0}] * 4 + [{"c": 5.0}]
    assert "curriculum" not in make().reset()[1]


def test_terms_are_called_before_the_reset_for_those_who_are_reset(make) -> None:
    seen = []

    def look(env, env_ids):
        ids = None if env_ids is None else env_ids.tolist()
        seen.append(
            (ids, env.elapsed_steps.tolist(), env.reward_manager.episode_sums["r"].tolist())
        )
        return {"depth": len(seen)}

    env = make(
        rewards={"r": RewardCfg(func=one)},
        curriculum={"look": CurriculumCfg(func=look)},
    )
    env.reset()
    env.step(act(env))
    env.reset(options={"reset_ids": [1]})
    assert seen == [(None, [0] * 3, [0.0] * 3), ([1], [1] * 3, [1.0] * 3)]
    assert env.step(act(env))[4]["curriculum"] == {"look/depth": 2.0}


def param(section: str, **params: Any) -> dict[str, CurriculumCfg]:
    given = {"section": section, "term_name": "r", "num_steps": 2, **params}
    return {"c": CurriculumCfg(func="modify_term_param", params=given)}


def test_a_parameter_of_a_function_changes(make) -> None:
    env = make(
        rewards={"r": RewardCfg(func=amount)},
        curriculum=param("rewards", param="size", value=3.0, num_steps=8, interpolate=True),
        max_episode_steps=2,
    )
    env.reset()
    assert rewards(env, 10) == [1.0, 1.0, 1.5, 1.5, 2.0, 2.0, 2.5, 2.5, 3.0, 3.0]


def test_a_part_of_a_parameter_changes(make) -> None:
    env = make(
        rewards={"r": RewardCfg(func=amount, params={"pair": [1.0, 2.0]})},
        curriculum=param("rewards", param="pair.1", value=7.0),
        max_episode_steps=2,
    )
    env.reset()
    assert rewards(env, 4) == [4.0, 4.0, 9.0, 9.0]


def test_two_changes_of_one_term_do_not_undo_each_other(make) -> None:
    changes = {
        "a": param("rewards", param="size", value=10.0, num_steps=2)["c"],
        "b": param("rewards", param="pair.0", value=100.0, num_steps=4)["c"],
    }
    env = make(
        rewards={"r": RewardCfg(func=amount, params={"pair": [1.0, 2.0]})},
        curriculum=changes,
        max_episode_steps=2,
    )
    env.reset()
    assert rewards(env, 6) == [4.0, 4.0, 13.0, 13.0, 112.0, 112.0]
    assert env.cfg.rewards["r"].params == {"pair": [1.0, 2.0]}  # the config stays as it was


def test_a_parameter_of_a_shape_changes(make) -> None:
    env = make(
        rewards={"r": RewardCfg(func=amount, params={"size": 4.0}, shape={"clip": [0.0, 1.0]})},
        curriculum=param("rewards", param="shape.clip.1", value=3.0, num_steps=4, interpolate=True),
        max_episode_steps=2,
    )
    env.reset()
    saved = env.state_dict()
    assert rewards(env, 6) == [1.0, 1.0, 2.0, 2.0, 3.0, 3.0]
    late = env.state_dict()
    env.load_state_dict(saved)
    assert rewards(env, 2) == [1.0, 1.0]
    env.load_state_dict(late)
    assert rewards(env, 2) == [3.0, 3.0]


class Summing:
    """A class that keeps a sum, and has a parameter."""

    def __init__(self, env, step: float = 1.0) -> None:
        self.step, self.total = step, torch.zeros(env.num_envs)

    def __call__(self, env, obs, action, info):
        self.total = self.total + self.step
        return self.total.clone()

    def state_dict(self):
        return {"total": self.total.clone()}

    def load_state_dict(self, state) -> None:
        self.total = state["total"].clone()


def test_a_class_keeps_its_state_when_a_parameter_changes(make) -> None:
    env = make(
        rewards={"r": RewardCfg(func=Summing)},
        curriculum=param("rewards", param="step", value=10.0),
        max_episode_steps=2,
    )
    env.reset()
    first = env.reward_manager.terms["r"].instance.total[0].item()  # the check at build counts
    assert rewards(env, 4) == [first + n for n in (1.0, 2.0, 12.0, 22.0)]


def test_the_range_of_an_event_changes(make) -> None:
    box = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    params = {"entity_cfg": {"uid": "goal"}, "position_range": box}
    env = make(
        events={"r": EventCfg(func="randomize_rigid_object_pose", params=params)},
        curriculum=param("events", param="position_range.1.0", value=0.4),
        observations={
            "x": ObservationCfg(
                func="get_object_pose", params={**entity("goal"), "to_matrix": False}
            )
        },
        max_episode_steps=2,
        num_envs=32,
    )
    obs, _ = env.reset()
    assert obs["x"][:, 0].std() == 0.0
    for _ in range(2):
        obs = env.step(act(env))[0]
    x = obs["x"][:, 0]
    assert x.min() >= 0.5
    assert 0.8 < x.max() <= 0.9
    assert (obs["x"][:, 1:3] == torch.tensor([0.2, 0.5])).all()


def entity(uid: str) -> dict[str, Any]:
    return {"entity_cfg": {"uid": uid}}


def test_other_sections(make) -> None:
    env = make(
        commands={
            "r": CommandCfg(
                func="uniform_joint_position",
                params={**entity("ur10"), "position_range": [0.0, 0.0]},
            )
        },
        curriculum=param("commands", param="position_range", value=[0.2, 0.2]),
        max_episode_steps=2,
    )
    env.reset()
    before = env.command_manager.values("r").copy()
    env.step(act(env))
    env.step(act(env))
    assert env.command_manager.values("r") == pytest.approx(before + 0.2)
    env = make(
        terminations={"r": TerminationCfg(func="time_out", params={"time_limit_s": 0.04})},
        curriculum=param("terminations", param="time_limit_s", value=0.12),
    )
    env.reset()
    ends = [env.step(act(env))[3][0].item() for _ in range(8)]
    assert ends == [True, True, False, False, True, False, False, True]


def whole() -> dict[str, Any]:
    sections = weight(num_steps=20, interpolate=True)
    sections["rewards"]["s"] = RewardCfg(func=amount)
    sections["curriculum"]["d"] = param(
        "rewards", term_name="s", param="size", value=3.0, num_steps=20, interpolate=True
    )["c"]
    return sections


def test_a_saved_environment_continues_to_the_bit(make) -> None:
    env = make(**whole())
    env.reset()
    rewards(env, 9)
    saved = env.state_dict()
    wanted = rewards(env, 12)
    assert len(set(wanted)) > 4
    other = make(**whole())
    other.reset()
    other.load_state_dict(saved)
    assert rewards(other, 12) == wanted
    env.load_state_dict(saved)  # also backwards, where more has been changed
    assert rewards(env, 12) == wanted


def test_the_schedule_does_not_depend_on_the_number_of_environments(make) -> None:
    found = []
    for num_envs in (1, 3, 64):
        env = make(**whole(), num_envs=num_envs)
        env.reset()
        found.append(rewards(env, 12))
    assert found[0] == found[1] == found[2]


def test_an_unknown_reward_is_an_error_at_build(make) -> None:
    with pytest.raises(ConfigError, match=r"curriculum\.c\.params\.term_name: there is no 'x'"):
        make(**weight(term_name="x"))
