"""What each tolerance term measures; the kernels themselves are in test_kernels."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import RewardCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.judging import bend, move, put, reward, turned
from tests.helpers.ur10_task import HOME, builder

CUBE, GOAL = {"uid": "cube"}, {"uid": "goal"}
FIRST = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint[12]"}}
LINEAR = {"margin": 2.0, "sigmoid": "linear", "value_at_margin": 0.0}  # 1 - excess / 2


@pytest.fixture(scope="module")
def scene() -> Iterator[Any]:
    with builder() as build:
        env = build()
        env.reset()
        yield env


def test_distance(scene) -> None:
    put(scene, "goal", (0, 0, 1))
    put(scene, "cube", [(0.3, 0, 1), (0.5, 0, 1), (0.3, 0, 1.4)])
    pair = {"source_entity_cfg": CUBE, "target_entity_cfg": GOAL, "bounds": [0.0, 0.3]}
    found = reward(scene, "tolerance_distance", **pair, **LINEAR)
    assert found == pytest.approx([1.0, 0.9, 0.9], abs=1e-6)
    flat = reward(scene, "tolerance_distance", **pair, **LINEAR, use_xy_only=True)
    assert flat == pytest.approx([1.0, 0.9, 1.0], abs=1e-6)
    step = reward(scene, "tolerance_distance", **{**pair, "bounds": [0.0, 0.4]})
    assert step == [1.0, 0.0, 0.0]


def test_height(scene) -> None:
    put(scene, "cube", [(0, 0, 1.0), (0, 0, 1.5), (0, 0, 9.0)])
    params = {"entity_cfg": CUBE, "bounds": [1.5, math.inf]}
    found = reward(scene, "tolerance_height", **params, **LINEAR)
    assert found == pytest.approx([0.75, 1.0, 1.0])
    found = reward(scene, "tolerance_height", **params, margin=0.5, value_at_margin=0.3)
    assert found == pytest.approx([0.3, 1.0, 1.0])


def test_orientation(scene) -> None:
    put(scene, "goal", (0, 0, 1), turned((1, 0, 0), 0.4))
    put(scene, "cube", (0, 0, 1), [turned((1, 0, 0), a) for a in (0.0, 0.4, math.pi)])
    tilt = reward(scene, "tolerance_orientation", entity_cfg=CUBE, **LINEAR)
    assert tilt == pytest.approx([1.0, 0.8, 0.0], abs=1e-6)
    pair = {"entity_cfg": CUBE, "target_entity_cfg": GOAL, "bounds": [0.0, 0.1]}
    found = reward(scene, "tolerance_orientation", **pair, **LINEAR)
    assert found == pytest.approx([0.85, 1.0, 0.0], abs=1e-6)


def test_velocity(scene) -> None:
    put(scene, "cube", (0, 0, 2), turned((0, 0, 1), math.pi / 2))
    move(scene, "cube", [(0.6, 0.8, 0), (0, 0, 0), (0, 3, 0)])
    params = {"entity_cfg": CUBE, "bounds": [1.0, 2.0]}
    found = reward(scene, "tolerance_velocity", **params, **LINEAR)
    assert found == pytest.approx([1.0, 0.5, 0.5], abs=1e-6)
    ahead = {**params, "direction": [0, 2, 0]}
    found = reward(scene, "tolerance_velocity", **ahead, **LINEAR)
    assert found == pytest.approx([0.9, 0.5, 0.5], abs=1e-6)
    body = {**params, "direction": [2, 0, 0], "frame": "body"}
    found = reward(scene, "tolerance_velocity", **body, **LINEAR)
    assert found == pytest.approx([0.9, 0.5, 0.5], abs=1e-6)
    with pytest.raises(ConfigError, match="direction: must not be zero"):
        reward(scene, "tolerance_velocity", **{**params, "direction": [0, 0, 0]})


def test_joints_are_averaged(scene) -> None:
    qpos = np.tile(HOME, (3, 1))
    qpos[:, :2] = [[0.0, 0.0], [0.5, -1.5], [2 * math.pi - 0.4, 0.0]]
    bend(scene, qpos, [0.0, 1.0, 0, 0, 0, 9])
    params = {**FIRST, "bounds": [-0.1, 0.5]}
    found = reward(scene, "tolerance_joint_position", **params, **LINEAR)
    assert found == pytest.approx([1.0, (1.0 + 0.3) / 2, (0.0 + 1.0) / 2], abs=1e-5)
    found = reward(scene, "tolerance_joint_position", **params, **LINEAR, periodic=True)
    assert found == pytest.approx([1.0, 0.65, (0.85 + 1.0) / 2], abs=1e-5)
    found = reward(scene, "tolerance_joint_velocity", **FIRST, **LINEAR)
    assert found == pytest.approx([0.75] * 3)


def test_actions_are_averaged(make) -> None:
    params = {"margin": 1.0, "sigmoid": "quadratic", "value_at_margin": 0.0}
    env = make(rewards={"r": RewardCfg(func="tolerance_action", params=params)})
    env.reset()
    action = torch.zeros(3, 6)
    action[1, :3] = torch.tensor([0.5, -0.5, 2.0])
    expected = [1.0, (0.75 + 0.75 + 0.0 + 3.0) / 6, 1.0]
    assert env.step(action)[1].tolist() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("params", "part"),
    [
        ({"bounds": [2.0, 1.0]}, "bounds: low 2.0 exceeds high 1.0"),
        ({"bounds": [0.0, math.nan]}, "bounds: a bound is not a number"),
        ({"bounds": [0.0, 1.0], "margin": -1}, "margin: .*at least 0"),
        ({"bounds": [0.0, 1.0], "sigmoid": "gauss"}, "sigmoid: .*'gaussian'"),
        ({"bounds": [0.0, 1.0], "value_at_margin": 1.0}, "value_at_margin: .*less than 1"),
        ({"bounds": [0.0, 1.0], "value_at_margin": 0.0}, "value_at_margin: must be in"),
    ],
)
def test_wrong_kernels_are_reported_by_parameter(make, params, part) -> None:
    with pytest.raises(ConfigError, match=f"rewards.r.params.{part}"):
        make(
            rewards={"r": RewardCfg(func="tolerance_height", params={"entity_cfg": CUBE, **params})}
        )
