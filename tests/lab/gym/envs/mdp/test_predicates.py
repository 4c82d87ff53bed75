"""Yes-or-no terms on both sides of their thresholds, and terms made of them."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg, TerminationCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.judging import bend, ends, holds, move, put, reward, turned
from tests.helpers.ur10_task import HOME, builder

CUBE = {"uid": "cube"}
PAIR = {"source_entity_cfg": CUBE, "target_entity_cfg": {"uid": "goal"}}
NEAR = {"func": "within_distance", "params": {**PAIR, "threshold": 0.15}}
HIGH = {"func": "height_above", "params": {"entity_cfg": CUBE, "threshold": 1.0}}


@pytest.fixture(scope="module")
def scene() -> Iterator[Any]:
    with builder() as build:
        env = build()
        env.reset()
        yield env


def test_within_orientation_and_pose(scene) -> None:
    """Environments differ: aligned and near, turned by 0.3 rad, and 0.2 m away."""
    put(scene, "goal", (0, 0, 1))
    quats = [[1, 0, 0, 0], turned([1, 0, 0], 0.3), [1, 0, 0, 0]]
    put(scene, "cube", [(0.1, 0, 1), (0.1, 0, 1), (0.2, 0, 1)], quats)
    assert holds(scene, "within_orientation", **PAIR, threshold=0.29) == [True, False, True]
    assert holds(scene, "within_orientation", **PAIR, threshold=0.31) == [True, True, True]
    pose = {**PAIR, "position_threshold": 0.15, "orientation_threshold": 0.29}
    assert holds(scene, "within_pose", **pose) == [True, False, False]
    assert holds(scene, "within_distance", **PAIR, threshold=0.15) == [True, True, False]


def test_heights(scene) -> None:
    put(scene, "cube", [(0, 0, 0.5), (0, 0, 1.0), (0, 0, 1.5)])
    assert holds(scene, "height_above", entity_cfg=CUBE, threshold=1.0) == [False, False, True]
    assert holds(scene, "height_below", entity_cfg=CUBE, threshold=1.0) == [True, False, False]


def test_joint_within_takes_bounds_in_and_every_joint_counts(scene) -> None:
    qpos = np.tile(HOME, (3, 1))
    qpos[:, :2] = [[0.1, 0.2], [0.1, 0.3], [-0.2, 0.2]]
    bend(scene, qpos)
    picked = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint[12]"}}
    assert holds(scene, "joint_within", **picked, bounds=[-0.1, 0.2]) == [True, False, False]
    assert holds(scene, "joint_within", **picked, bounds=[-0.2, 0.2]) == [True, False, True]
    assert holds(scene, "joint_within", **picked, bounds=[-math.inf, 0.2]) == [True, False, True]


def test_joint_within_a_turn(scene) -> None:
    qpos = np.tile(HOME, (3, 1))
    qpos[:, 0] = [2 * math.pi - 0.1, -2 * math.pi + 0.05, math.pi]
    bend(scene, qpos)
    first = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint1"}, "bounds": [-0.15, 0.1]}
    assert holds(scene, "joint_within", **first) == [False] * 3
    assert holds(scene, "joint_within", **first, periodic=True) == [True, True, False]


def test_joint_vel_within(scene) -> None:
    qvel = np.zeros((3, 6))
    qvel[:, 5] = [0.1, -0.3, 0.2]
    bend(scene, HOME, qvel)
    arm = {"entity_cfg": {"uid": "ur10"}}
    assert holds(scene, "joint_vel_within", **arm, threshold=0.2) == [True, False, False]


def test_at_rest(scene) -> None:
    put(scene, "cube", (0, 0, 2))
    move(scene, "cube", [(0.1, 0, 0), (0, 0.3, 0.4), (0, 0, 0)], [(0, 0, 0), (0, 0, 0), (0, 0, 2)])
    cube = {"entity_cfg": CUBE}
    assert holds(scene, "at_rest", **cube, linear_threshold=0.2) == [True, False, True]
    assert holds(scene, "at_rest", **cube, angular_threshold=1.0) == [True, True, False]
    both = {"linear_threshold": 0.2, "angular_threshold": 1.0}
    assert holds(scene, "at_rest", **cube, **both) == [True, False, False]
    with pytest.raises(ConfigError, match="linear_threshold, angular_threshold or both"):
        holds(scene, "at_rest", **cube)


def test_predicates_are_joined(scene) -> None:
    put(scene, "goal", (0, 0, 1))
    put(scene, "cube", [(0, 0, 1.1), (0, 0, 0.9), (0, 0, 1.5)])
    terms = {"terms": {"near": NEAR, "high": HIGH}}
    assert holds(scene, "all_of", **terms) == [True, False, False]
    assert holds(scene, "any_of", **terms) == [True, True, True]
    put(scene, "cube", [(0, 0, 1.1), (0, 0, 0.5), (0, 0, 1.5)])
    assert holds(scene, "any_of", **terms) == [True, False, True]


def test_terms_are_multiplied(scene) -> None:
    put(scene, "goal", (0, 0, 1))
    put(scene, "cube", [(0, 0, 1.1), (0, 0, 0.9), (0, 0, 1.5)])
    close = {"func": "distance_tanh", "params": {**PAIR, "std": 0.1}}
    found = reward(scene, "product_of", terms={"close": close, "high": HIGH})
    assert found == pytest.approx([1 - math.tanh(1), 0.0, 1 - math.tanh(5)], abs=1e-6)


def test_held_for_counts_steps_in_a_row_and_starts_anew_at_resets(make) -> None:
    params = {"term": HIGH, "steps": 3}
    env = make(
        metrics={"held": MetricCfg(func="held_for", params=params)},
        rewards={"r": RewardCfg(func="held_for", params={"term": HIGH, "time_s": 0.12})},
    )
    env.reset()

    def step(*heights: float) -> list[float]:
        put(env, "cube", [(0, 0, height) for height in heights])
        _, paid, _, _, info = env.step(env.robot.get_qpos(target=True))
        assert info["metrics"]["held"].tolist() == paid.tolist()  # a control step is 0.04 s
        return paid.tolist()

    assert step(5, 5, 5) == [0, 0, 0]
    assert step(5, 0, 5) == [0, 0, 0]
    saved = env.state_dict()
    assert step(5, 5, 5) == [1, 0, 1]
    env.load_state_dict(saved)
    assert step(5, 5, 5) == [1, 0, 1]
    assert step(5, 5, 0) == [1, 0, 0]
    env.reset(options={"reset_ids": [0]})
    assert step(5, 5, 5) == [0, 1, 0]
    assert step(5, 5, 5) == [0, 1, 0]
    assert step(5, 5, 5) == [1, 1, 1]


def test_an_inner_term_that_remembers_is_reset_and_restored(make) -> None:
    slow = {"slow": {"func": "joint_acc_l2", "params": {"entity_cfg": {"uid": "ur10"}}}}
    env = make(rewards={"r": RewardCfg(func="product_of", params={"terms": slow})})
    env.reset()
    home = torch.tensor([HOME]).repeat(3, 1)
    assert env.step(home)[1].tolist() == [0.0] * 3
    env.robot.set_qvel(np.ones((3, 6)), target=False)
    saved = env.state_dict()
    first = env.step(home)[1]
    assert (first > 0).all()
    env.load_state_dict(saved)
    assert torch.equal(env.step(home)[1], first)
    env.reset(options={"reset_ids": [2]})
    found = env.step(home)[1]
    assert (found[:2] > 0).all() and found[2] == 0.0


@pytest.mark.parametrize(
    ("params", "part"),
    [
        ({"terms": {}}, "terms: expected at least 1 item, got {}"),
        ({"terms": {"a": {"func": "heigt_above"}}}, "terms.a: .*'heigt_above'.*height_above"),
        (
            {"terms": {"a": {"func": "within_distance", "params": {**PAIR, "threshold": -1}}}},
            "terms.a: params.threshold: .*greater than 0",
        ),
        ({"terms": {"a": {"func": "os:getcwd"}}}, "must be a registered one"),
        ({"terms": {"a": {"func": "height_above", "weight": 2}}}, "terms.a.weight"),
        (
            {"terms": {"a": {**HIGH, "params": {"entity_cfg": {"uid": "cub"}, "threshold": 1}}}},
            "terms.a.params.entity_cfg.uid: no entity is called 'cub'",
        ),
    ],
)
def test_wrong_inner_terms_are_reported_where_they_stand(make, params, part) -> None:
    with pytest.raises(ConfigError, match=part):
        make(metrics={"m": MetricCfg(func="all_of", params=params)})


@pytest.mark.parametrize("params", [{}, {"steps": 2, "time_s": 1.0}])
def test_held_for_needs_one_duration(make, params) -> None:
    with pytest.raises(ConfigError, match="either steps or time_s"):
        make(metrics={"m": MetricCfg(func="held_for", params={"term": HIGH, **params})})


def test_success_of_position_and_orientation_ends_an_episode(make) -> None:
    pose = {**PAIR, "position_threshold": 0.1, "orientation_threshold": 0.2}
    done = {"term": {"func": "within_pose", "params": pose}, "steps": 2}
    env = make(terminations={"done": TerminationCfg(func="held_for", kind="success", params=done)})
    env.reset()
    home = torch.tensor([HOME]).repeat(3, 1)
    ended = []
    for _ in range(2):
        quats = [[1, 0, 0, 0], turned([0, 1, 0], 0.5), [1, 0, 0, 0]]
        put(env, "goal", (0, 2, 3))
        put(env, "cube", [(0, 2, 3), (0, 2, 3), (0, 2, 4)], quats)
        move(env, "cube")
        _, _, terminated, _, info = env.step(home)
        ended.append(terminated.tolist())
    assert ended == [[False] * 3, [True, False, False]]
    assert info["success"].tolist() == [True, False, False]


def test_bad_orientation(scene) -> None:
    put(scene, "cube", (0, 0, 2), [turned([0, 1, 0], a) for a in (0.49, 0.51, 3.0)])
    found = ends(scene, "bad_orientation", entity_cfg=CUBE, limit_angle=0.5)
    assert found == [False, True, True]


def test_root_height_below_minimum(scene) -> None:
    put(scene, "cube", [(0, 0, 0.19), (0, 0, 0.2), (0, 0, 0.21)])
    found = ends(scene, "root_height_below_minimum", entity_cfg=CUBE, minimum_height=0.2)
    assert found == [True, False, False]
