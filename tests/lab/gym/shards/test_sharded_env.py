"""A batch in shards gives the results of one batch, to the bit; so does one that loses shards."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.shards import shard_pool
from tests.helpers.local_shards import sharded

pytestmark = pytest.mark.slow

OVERRIDES = [
    "task.max_episode_steps=25",
    "+task.observations.qvel.noise={std: 0.01}",
    "+task.curriculum.later={func: modify_reward_weight, params: {term_name: alive, weight: 3.0,"
    " num_steps: 30, interpolate: true}}",
]


def build(first: int, count: int, seed: int = 3) -> Any:
    lines = [*OVERRIDES, f"sim.first_env={first}", "sim.num_threads=1"]
    return embodichain.make("cart_pole", num_envs=count, seed=seed, overrides=lines)


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    """Every array of a nested mapping, and every other value, by path."""
    if isinstance(value, Mapping):
        found = {}
        for key, part in value.items():
            found |= leaves(part, f"{path}/{key}")
        return found or {path: "empty"}
    return {path: value}


def assert_same(a: Any, b: Any) -> None:
    mine, other = leaves(a), leaves(b)
    assert mine.keys() == other.keys()
    for path, value in mine.items():
        if isinstance(value, torch.Tensor):
            assert value.dtype == other[path].dtype, path
            assert value.numpy().tobytes() == other[path].numpy().tobytes(), path
        else:
            assert value == other[path], path


def compare(whole: Any, parts: Any, steps: int) -> int:
    """Step both with the same actions; return how many episodes ended."""
    ended = 0
    for _ in range(steps):
        action = whole.rand("policy", (1,), -1, 1)
        assert_same({"action": action}, {"action": parts.rand("policy", (1,), -1, 1)})
        ours, theirs = whole.step(action), parts.step(action)
        for one, other in zip(ours, theirs, strict=True):
            assert_same({"": one}, {"": other})
        ended += int((ours[2] | ours[3]).sum())
        values = whole.termination_manager.values
        assert_same(dict(values), parts.termination_manager.values)
        assert whole.curriculum_manager.values == parts.curriculum_manager.values
    return ended


def test_results_are_those_of_one_batch() -> None:
    """Observations, rewards, ends, info with its final entries, draws, curricula."""
    whole = build(0, 7)
    with sharded(build, 7, 3) as (parts, source):
        assert parts.pool.counts == (3, 2, 2) and parts.pool.firsts == (0, 3, 5)
        assert parts.action_space == whole.action_space
        assert parts.observation_space == whole.observation_space
        for one, other in zip(whole.reset(seed=5), parts.reset(seed=5), strict=True):
            assert_same(one, other)
        assert compare(whole, parts, 60) > 14
        # some environments, of one shard only
        ids = {"options": {"reset_ids": [0, 2]}}
        for one, other in zip(whole.reset(**ids), parts.reset(**ids), strict=True):
            assert_same(one, other)
        compare(whole, parts, 15)
        groups = whole.observation_manager.flatten(whole.reset()[0])
        assert torch.equal(groups, parts.observation_manager.flatten(parts.reset()[0]))
        saved, steps = (whole.state_dict(), parts.state_dict()), compare(whole, parts, 9)
        whole.load_state_dict(saved[0])
        parts.load_state_dict(saved[1])
        assert compare(whole, parts, 9) == steps
        with pytest.raises(ValueError, match=r"action must have shape \(7, 1\)"):
            parts.step(torch.zeros(6, 1))
        with pytest.raises(ValueError, match="not finite"):
            parts.step(torch.full((7, 1), torch.nan))
        with pytest.raises(TypeError, match="take a tensor"):
            parts.step({"qpos": torch.zeros(7, 1)})
        compare(whole, parts, 2)
    assert [shard.calls[-1] for shard in source.started] == ["close"] * 3
    whole.close()


@pytest.mark.parametrize("save_every", [1000, 6])
def test_lost_shards_are_rebuilt(save_every: int, caplog: pytest.LogCaptureFixture) -> None:
    """The rebuilt ones repeat their steps: the batch goes on to the bit."""
    whole = build(0, 5)
    with sharded(build, 5, 2, save_every) as (parts, source):
        whole.reset()
        parts.reset()
        compare(whole, parts, 15)
        source.running[1].lose()
        compare(whole, parts, 4)
        for shard in source.running.values():
            shard.lose()
        compare(whole, parts, 25)
        whole.reset(options={"reset_mask": np.arange(5) == 4})
        parts.reset(options={"reset_mask": np.arange(5) == 4})
        source.running[0].lose()
        compare(whole, parts, 5)
        since = [0, 0, 0, 0] if save_every == 1000 else [12, 18, 18, 42]
        found = [
            (r["shard"], r["lost_at_step"], r["continued_from_step"]) for r in parts.pool.rebuilt
        ]
        assert found == list(zip([1, 0, 1, 0], [15, 19, 19, 44], since, strict=True))
        assert parts.pool.rebuilt[0]["lost_on"] == "n1"
        assert parts.pool.rebuilt[0]["rebuilt_on"] == "n2"
        assert "shard 1 (environments 3 to 4) is lost on node n1: it was lost on" in caplog.text
        told = f"from its state at control step {since[-1]}; {44 - since[-1]} steps were repeated"
        assert told in caplog.text
    whole.close()


def test_what_is_not_here_is_refused_by_name() -> None:
    with sharded(build, 3, 2) as (parts, _):
        for name in ("episodes", "reward_manager", "robot"):
            with pytest.raises(AttributeError, match=f"^{name} is not on this machine"):
                getattr(parts, name)
        with pytest.raises(AttributeError, match=r"^sim.engine is not on this machine"):
            _ = parts.sim.engine
        with pytest.raises(AttributeError, match=r"^action_manager.hold is not"):
            parts.action_manager.hold()
        with pytest.raises(embodichain.utils.errors.ConfigError, match="of one process"):
            parts.add_observer(object())
        with pytest.raises(Exception, match="call reset"):
            parts.step(torch.zeros(3, 1))
        one = build(0, 3)
        with pytest.raises(embodichain.utils.errors.ConfigError, match="is from one process"):
            parts.load_state_dict(one.state_dict())
        one.close()
        parts.reset()
        state = parts.state_dict()
    with (
        sharded(build, 3, 3) as (parts, _),
        pytest.raises(embodichain.utils.errors.ConfigError, match=r"shards of \[2, 1\]"),
    ):
        parts.load_state_dict(state)


def test_a_shard_starts_again_if_its_node_is_dying(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    # Seconds pass before a shard starts once more, and twice as many the next time.
    monkeypatch.setattr(shard_pool, "_FIRST_PAUSE", 0.0)
    left = [2]

    def dying(first: int, count: int) -> Any:
        if count == 2 and left[0]:
            left[0] -= 1
            raise shard_pool.ShardLostError("its node is gone")
        return build(first, count)

    with sharded(dying, 3, 2) as (parts, source):
        parts.reset()
        assert len(source.started) == 2 and left == [0]
        assert caplog.text.count("shard 0 could not start: its node is gone") == 2
