"""Noise, clip, scale, delay and history: their order, their randomness, and who they are for."""

from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import EventCfg, NoiseCfg, ObservationCfg, TerminationCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME


class Count:
    """(N, 2): steps since the reset, and the environment's number: known without physics."""

    def __init__(self, env) -> None:
        pass

    def __call__(self, env, obs):
        steps = env.elapsed_steps.to(torch.float32)
        return torch.stack([steps, torch.arange(env.num_envs, dtype=torch.float32)], dim=1)


def count(**fields: Any) -> ObservationCfg:
    return ObservationCfg(func=Count, **fields)


def flat_five(env, obs):
    return torch.full((env.num_envs, 3), 5.0)


def five(**fields: Any) -> ObservationCfg:
    return ObservationCfg(func=flat_five, **fields)


def act(env: Any) -> torch.Tensor:
    return torch.tensor([HOME]).repeat(env.num_envs, 1)


def rollout(env: Any, name: str, steps: int) -> np.ndarray:
    """(steps + 1, N, ...) the entry after the reset and after each step."""
    obs, _ = env.reset()
    found = [obs[name].numpy()]
    for _ in range(steps):
        found.append(env.step(act(env))[0][name].numpy())
    return np.stack(found)


# -- noise -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("noise", "low", "high", "mean", "std"),
    [
        (NoiseCfg(type="uniform", low=-1.0, high=3.0), 4.0, 8.0, 6.0, 4 / np.sqrt(12)),
        (NoiseCfg(type="uniform", n_min=-1.0, n_max=3.0), 4.0, 8.0, 6.0, 4 / np.sqrt(12)),
        (NoiseCfg(type="uniform", low=0.5, high=1.5, operation="scale"), 2.5, 7.5, 5, 5 / 12**0.5),
        (NoiseCfg(type="uniform", low=1.0, high=2.0, operation="abs"), 1.0, 2.0, 1.5, 12**-0.5),
        (NoiseCfg(mean=1.0, std=0.5), 3.0, 9.0, 6.0, 0.5),
        (NoiseCfg(std=0.1, operation="scale", mean=1.0), 2.0, 8.0, 5.0, 0.5),
        (NoiseCfg(type="constant", bias=0.25), 5.25, 5.25, 5.25, 0.0),
    ],
)
def test_distributions(make, noise, low, high, mean, std) -> None:
    env = make(observations={"a": five(noise=noise)}, num_envs=512)
    values = rollout(env, "a", 3).reshape(-1, 3)
    assert low <= values.min()
    assert values.max() <= high
    assert values.mean() == pytest.approx(mean, abs=0.08 * (high - low))
    assert values.std() == pytest.approx(std, rel=0.06)
    if std:
        assert abs(np.corrcoef(values.T)[0, 1]) < 0.1  # columns
        assert len(np.unique(values[:512, 0])) == 512  # environments


def test_noise_of_each_column(make) -> None:
    noise = NoiseCfg(type="uniform", low=[0.0, 1.0, 2.0], high=[0.0, 1.0, 3.0])
    env = make(observations={"a": five(noise=noise)})
    values = rollout(env, "a", 4)
    assert (values[..., :2] == [5.0, 6.0]).all()
    assert ((values[..., 2] >= 7.0) & (values[..., 2] < 8.0)).all()
    assert len(np.unique(values[..., 2])) == values[..., 2].size


def test_corruption_can_be_switched_off_for_all_or_for_a_group(make) -> None:
    noise = NoiseCfg(std=1.0)
    terms = {"a": five(noise=noise), "b": five(noise=noise, group="critic")}
    seen = {}
    for switch in (True, False, {"critic": False}):
        obs, _ = make(observations=terms, enable_corruption=switch).reset()
        seen[str(switch)] = [(obs[name] != 5.0).any().item() for name in "ab"]
    assert seen == {"True": [1, 1], "False": [0, 0], "{'critic': False}": [1, 0]}


def test_noise_has_a_stream_of_its_own(make) -> None:
    one = make(observations={"a": five(noise=NoiseCfg(std=1.0))})
    two = make(
        observations={
            "b": five(noise=NoiseCfg(std=1.0)),
            "a": five(noise=NoiseCfg(std=1.0)),
        }
    )
    alone, beside = rollout(one, "a", 3), rollout(two, "a", 3)
    assert (alone == beside).all()
    assert (rollout(two, "b", 3) != beside).all()


def test_looking_between_steps_draws_nothing(make) -> None:
    terms = {
        "a": five(noise=NoiseCfg(std=1.0)),
        "b": count(noise=NoiseCfg(type="uniform", low=0, high=1), delay=[0, 2], history_length=3),
    }
    env, quiet = make(observations=terms), make(observations=terms)
    obs, wanted = env.reset()[0], quiet.reset()[0]
    for _ in range(4):
        looked = env.get_obs()
        assert torch.equal(looked["a"], obs["a"])
        assert torch.equal(looked["b"], obs["b"])
        obs, wanted = env.step(act(env))[0], quiet.step(act(quiet))[0]
        assert torch.equal(obs["a"], wanted["a"])
        assert torch.equal(obs["b"], wanted["b"])


# -- order -----------------------------------------------------------------------------------------


def test_the_order_of_the_pipeline(make) -> None:
    bias = NoiseCfg(type="constant", bias=2.5)
    env = make(observations={"a": five(noise=bias, clip=[0.0, 7.0], scale=2.0, history_length=2)})
    obs, _ = env.reset()
    assert obs["a"].tolist() == [[14.0] * 6] * 3  # 5 + 2.5, clipped to 7, doubled, twice


def test_delay_comes_before_history(make) -> None:
    env = make(observations={"a": count(delay=1, history_length=2)})
    assert rollout(env, "a", 3)[:, 0, ::2].tolist() == [[0, 0], [0, 0], [0, 1], [1, 2]]


# -- delay and history -----------------------------------------------------------------------------


def test_a_delay_hands_on_older_values(make) -> None:
    env = make(observations={"now": count(), "then": count(delay=2)})
    obs, _ = env.reset()
    found = []
    for _ in range(5):
        obs = env.step(act(env))[0]
        found.append((obs["now"][1, 0].item(), obs["then"][1, 0].item()))
    assert found == [(1, 0), (2, 0), (3, 1), (4, 2), (5, 3)]


def test_a_drawn_delay_lasts_for_an_episode(make) -> None:
    env = make(observations={"a": count(delay=[1, 3])}, num_envs=64, max_episode_steps=8)
    first = 7 - rollout(env, "a", 7)[-1, :, 0]
    assert set(first.tolist()) == {1.0, 2.0, 3.0}
    env.step(act(env))  # the episode ends, every delay is drawn anew
    for _ in range(7):
        obs = env.step(act(env))[0]
    second = 7 - obs["a"][:, 0].numpy()
    assert set(second.tolist()) == {1.0, 2.0, 3.0}
    assert (first != second).any()


def test_histories_are_flat_or_have_a_dimension(make) -> None:
    env = make(
        observations={
            "flat": count(history_length=3),
            "deep": count(history_length=3, flatten_history_dim=False),
        }
    )
    obs, _ = env.reset()
    for _ in range(4):
        obs = env.step(act(env))[0]
    assert obs["flat"][2].tolist() == [2, 2, 3, 2, 4, 2]
    assert obs["deep"].shape == (3, 3, 2)
    assert torch.equal(obs["deep"].reshape(3, -1), obs["flat"])
    assert env.observation_manager.columns() == {"flat": 6, "deep": 6}
    assert env.observation_manager.flatten(obs).shape == (3, 12)
    assert env.single_observation_space["deep"].shape == (3, 2)


def test_columns_are_those_of_the_group(make) -> None:
    env = make(
        observations={
            "x/a": five(),
            "b": five(group="critic"),
            "c": count(history_length=4),
        }
    )
    assert env.observation_manager.columns() == {"x/a": 3, "c": 8}
    assert env.observation_manager.columns("critic") == {"b": 3}


def test_a_reset_fills_the_past_of_its_environments_only(make) -> None:
    env = make(observations={"a": count(history_length=3), "d": count(delay=2)})
    env.reset()
    for _ in range(4):
        env.step(act(env))
    obs, _ = env.reset(options={"reset_ids": [1]})
    assert obs["a"][:, ::2].tolist() == [[2, 3, 4], [0, 0, 0], [2, 3, 4]]
    assert obs["d"][:, 0].tolist() == [2, 0, 2]
    obs = env.step(act(env))[0]
    assert obs["a"][:, ::2].tolist() == [[3, 4, 5], [0, 0, 1], [3, 4, 5]]
    obs = env.step(act(env))[0]
    assert obs["a"][:, ::2].tolist() == [[4, 5, 6], [0, 1, 2], [4, 5, 6]]
    assert obs["d"][:, 0].tolist() == [4, 0, 4]


# -- everything at once ----------------------------------------------------------------------------


def shake(env: Any, env_ids: Any) -> None:
    count = env.num_envs if env_ids is None else len(env_ids)
    drawn = torch.from_numpy(env.event_manager.draw("qpos", (6,), -0.3, 0.3, env_ids).copy())
    env.robot.set_qpos(torch.tensor([HOME]).repeat(count, 1) + drawn, env_ids=env_ids)


def everything() -> dict[str, Any]:
    robot = {"entity_cfg": {"uid": "ur10"}}
    return {
        "events": {"shake": EventCfg(func=shake)},
        "observations": {
            "q": ObservationCfg(
                func="joint_position",
                params=robot,
                noise=NoiseCfg(std=0.1),
                clip=[-1.0, 1.0],
                scale=0.5,
                delay=[0, 3],
                history_length=3,
            ),
            "v": ObservationCfg(
                func="joint_velocity",
                params=robot,
                noise=NoiseCfg(type="uniform", low=0.9, high=1.1, operation="scale"),
                delay=[1, 2],
            ),
        },
    }


def whole(env: Any, steps: int, resets: dict[int, list[int]]) -> np.ndarray:
    """(N, steps, W) flattened observations; `resets` says who is reset before which step."""
    env.reset()
    found = []
    for step in range(steps):
        if step in resets:
            env.reset(options={"reset_ids": resets[step]})
        obs = env.step(act(env) + 0.1 * np.sin(step))[0]
        found.append(env.observation_manager.flatten(obs).numpy())
    return np.stack(found, axis=1)


def test_no_byte_depends_on_the_number_of_environments(make) -> None:
    resets = {3: [0], 7: [0]}
    alone = whole(make(num_envs=1, **everything()), 12, resets)
    few = whole(make(num_envs=3, **everything()), 12, resets)
    many = whole(make(num_envs=64, **everything()), 12, resets)
    assert alone.tobytes() == few[:1].tobytes()
    assert few.tobytes() == many[:3].tobytes()


def test_a_partial_reset_leaves_the_others_bit_identical(make) -> None:
    quiet = whole(make(**everything()), 12, {})
    found = whole(make(**everything()), 12, {3: [1], 4: [1], 8: [1]})
    assert found[[0, 2]].tobytes() == quiet[[0, 2]].tobytes()
    assert (found[1] != quiet[1]).any()


def test_the_observation_of_a_partial_reset_repeats_that_of_the_others(make) -> None:
    env = make(**everything())
    env.reset()
    for _ in range(5):
        before = env.observation_manager.flatten(env.step(act(env))[0])
    after = env.observation_manager.flatten(env.reset(options={"reset_ids": [1]})[0])
    assert torch.equal(after[[0, 2]], before[[0, 2]])


class Sometimes:
    """Ends environment 1 after three steps of every episode, nobody else's."""

    def __init__(self, env) -> None:
        pass

    def __call__(self, env, obs, action, info):
        ends = env.elapsed_steps == 2
        ends[[i for i in range(env.num_envs) if i != 1]] = False
        return ends


@pytest.mark.parametrize("mode", ["SAME_STEP", "NEXT_STEP"])
def test_automatic_resets_leave_the_others_bit_identical(make, mode: str) -> None:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from tests.helpers.ur10_task import task

    ends = {"t": TerminationCfg(func=Sometimes)}
    found = {}
    for name, terminations in (("ending", ends), ("quiet", {})):
        env = BaseEnv(task(**everything(), terminations=terminations), autoreset_mode=mode)
        found[name] = whole(env, 12, {})
        env.close()
    assert found["ending"][[0, 2]].tobytes() == found["quiet"][[0, 2]].tobytes()
    assert (found["ending"][1] != found["quiet"][1]).any()


def test_an_automatic_reset_equals_an_explicit_one(make) -> None:
    def run(mode: str) -> list[torch.Tensor]:
        from embodichain.lab.gym.envs.base_env import BaseEnv
        from tests.helpers.ur10_task import task

        env = BaseEnv(task(**everything(), max_episode_steps=4), autoreset_mode=mode)
        env.reset()
        found = []
        for _ in range(9):
            obs, _, _, truncated, _ = env.step(act(env))
            if mode == "DISABLED" and truncated.any():
                obs, _ = env.reset()
            found.append(env.observation_manager.flatten(obs))
        env.close()
        return found

    for automatic, explicit in zip(run("SAME_STEP"), run("DISABLED"), strict=True):
        assert torch.equal(automatic, explicit)


def test_a_saved_environment_continues_to_the_bit(make) -> None:
    env = make(**everything())
    whole(env, 5, {2: [1]})
    saved = env.state_dict()
    other = make(**everything())
    other.reset(seed=3)
    other.load_state_dict(saved)
    for _ in range(5):
        one, two = env.step(act(env))[0], other.step(act(other))[0]
        assert torch.equal(one["q"], two["q"])
        assert torch.equal(one["v"], two["v"])


def test_what_is_handed_out_may_be_written_to(make) -> None:
    env = make(**everything())
    other = make(**everything())
    env.reset()
    other.reset()
    for _ in range(4):
        obs, wanted = env.step(act(env))[0], other.step(act(other))[0]
        assert torch.equal(obs["q"], wanted["q"])
        obs["q"].zero_()
        obs["v"].zero_()


def test_a_modified_entry_has_a_pipeline_too(make) -> None:
    env = make(
        observations={
            "a": five(),
            "more": ObservationCfg(
                func=lambda env, data: 2.0 * data, mode="modify", name="a", history_length=2
            ),
        }
    )
    obs, _ = env.reset()
    assert obs["a"].tolist() == [[10.0] * 6] * 3
    assert env.observation_manager.columns() == {"a": 6}


def test_a_value_that_is_not_finite_stays_so(make) -> None:
    def broken(env, obs):
        value = torch.ones(env.num_envs, 1)
        if env.control_step == 3:
            value[1] = float("nan")
        return value

    env = make(
        observations={
            "a": ObservationCfg(func=broken, noise=NoiseCfg(std=0.1), clip=[-9, 9], scale=2.0)
        }
    )
    env.reset()
    diverged = [env.step(act(env))[4]["diverged"].tolist() for _ in range(4)]
    assert diverged == [[False] * 3, [False] * 3, [False, True, False], [False] * 3]


@pytest.mark.parametrize(
    ("fields", "path", "part"),
    [
        ({"noise": NoiseCfg(std=[1.0, 2.0])}, "noise.std", "has 2 values"),
        ({"scale": [1.0, 2.0]}, "scale", "has 2 values"),
    ],
)
def test_lists_must_fit_the_last_dimension(make, fields, path: str, part: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make(observations={"a": five(**fields)})
    (problem,) = caught.value.problems
    assert problem.path == f"observations.a.{path}"
    assert part in problem.message
