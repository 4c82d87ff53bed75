"""Observations, rewards and terminations on cases worked by hand."""

import math

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import (
    MetricCfg,
    ObservationCfg,
    RewardCfg,
    TerminationCfg,
)
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import CUBE_POS, GOAL_POS, HOME

CUBE = {"entity_cfg": {"uid": "cube"}}
ARM = {"entity_cfg": {"uid": "ur10"}}
PAIR = {"source_entity_cfg": {"uid": "cube"}, "target_entity_cfg": {"uid": "goal"}}
TOOL = {"uid": "ur10", "link_names": ["ee_link"]}
DISTANCE = math.dist(CUBE_POS, GOAL_POS)  # cube (0.5, 0.5, 0.05) to goal (0.5, 0.2, 0.5)


def observed(make, func: str, params=None, **fields) -> torch.Tensor:
    env = make(observations={"it": ObservationCfg(func=func, params=params or {}, **fields)})
    obs, _ = env.reset()
    return obs["it"]


def evaluated(env, func: str, **params) -> torch.Tensor:
    """A reward-like term's value now, without a step."""
    from embodichain.lab.gym.envs.managers import RewardManager

    manager = RewardManager(env, {"it": RewardCfg(func=func, params=params)})
    info = {}
    manager.compute(torch.zeros(env.num_envs), None, None, info)
    return info["rewards"]["it"]


def test_object_pose_as_vector_and_matrix(make) -> None:
    vector = observed(make, "get_object_pose", {**CUBE, "to_matrix": False})
    half = math.sqrt(0.5)
    assert torch.allclose(vector, torch.tensor([*CUBE_POS, half, 0, 0, half]).expand(3, 7))
    matrix = observed(make, "get_object_pose", CUBE)
    expected = torch.tensor(
        [[0.0, -1, 0, 0.5], [1, 0, 0, 0.5], [0, 0, 1, 0.05], [0, 0, 0, 1]], dtype=torch.float32
    )
    assert torch.allclose(matrix, expected.expand(3, 4, 4), atol=1e-6)


def test_link_pose_and_root(make) -> None:
    env = make(
        observations={
            "tool": ObservationCfg(func="link_pose", params={"entity_cfg": TOOL}),
            "root": ObservationCfg(func="link_pose", params=ARM),
        }
    )
    obs, _ = env.reset()
    assert torch.equal(obs["tool"], env.robot.get_link_pose("ee_link"))
    assert torch.allclose(obs["root"][0], torch.tensor([0.0, 0, 1, 1, 0, 0, 0]))


def test_velocities(make) -> None:
    env = make(
        observations={
            "cube": ObservationCfg(func="get_rigid_object_velocity", params=CUBE),
            "goal": ObservationCfg(
                func="get_rigid_object_velocity", params={"entity_cfg": {"uid": "goal"}}
            ),
            "qvel": ObservationCfg(func="joint_velocity", params=ARM, scale=0.1),
            "tool": ObservationCfg(func="link_velocity", params={"entity_cfg": TOOL}),
            "root": ObservationCfg(func="link_velocity", params=ARM),
        }
    )
    env.reset()
    env.sim.get_asset("cube").set_velocity(np.full((3, 3), 2.0), np.tile([0.0, 0, 3], (3, 1)))
    env.robot.set_qvel(np.full((3, 6), 0.5), target=False)
    obs = env.get_obs()
    assert torch.allclose(obs["cube"], torch.tensor([2.0, 2, 2, 0, 0, 3]).expand(3, 6), atol=1e-6)
    assert not obs["goal"].any()
    assert torch.allclose(obs["qvel"], torch.full((3, 6), 0.05))
    # Differences of the tool's position over a tiny time give its velocity.
    before = env.robot.get_link_pose("ee_link").double()
    dt = 1e-3
    env.robot.set_qpos(env.robot.read_qpos() + 0.5 * dt, target=False)
    moved = (env.robot.get_link_pose("ee_link").double() - before)[:, :3] / dt
    assert torch.allclose(obs["tool"][:, :3].double(), moved, atol=2e-3)
    assert not obs["root"].any()


def test_joint_positions(make) -> None:
    picked = {"entity_cfg": {"uid": "ur10", "joint_names": ["Joint2", "Joint1"]}}
    env = make(
        observations={
            "all": ObservationCfg(func="joint_position", params=ARM),
            "some": ObservationCfg(func="joint_position", params=picked),
            "rel": ObservationCfg(func="joint_position_relative", params=ARM),
            "rel2": ObservationCfg(func="joint_position_relative", params=picked),
        }
    )
    obs, _ = env.reset()
    assert torch.equal(obs["all"], torch.tensor(HOME).expand(3, 6))
    assert torch.equal(obs["some"], torch.tensor(HOME[:2]).expand(3, 2))
    assert not obs["rel"].any()
    env.robot.set_qpos(np.tile(HOME, (3, 1)) + 0.25, target=False)
    obs = env.get_obs()
    assert torch.allclose(obs["rel"], torch.full((3, 6), 0.25), atol=1e-6)
    assert torch.allclose(obs["rel2"], torch.full((3, 2), 0.25), atol=1e-6)


def test_relative_position_points_from_source_to_target(make) -> None:
    found = observed(make, "relative_position", PAIR)
    assert torch.allclose(found, torch.tensor([0.0, -0.3, 0.45]).expand(3, 3), atol=1e-6)


def test_last_action_is_what_was_given_and_zero_after_a_reset(make) -> None:
    env = make(observations={"a": ObservationCfg(func="last_action")})
    obs, _ = env.reset()
    assert not obs["a"].any()
    action = torch.from_numpy(np.tile(HOME, (3, 1)).astype(np.float32))
    obs = env.step(action)[0]
    assert torch.equal(obs["a"], action)
    obs, _ = env.reset(options={"reset_ids": [1]})
    assert torch.equal(obs["a"][[0, 2]], action[[0, 2]])
    assert not obs["a"][1].any()


def test_distance(make) -> None:
    env = make()
    env.reset()
    found = evaluated(env, "distance_between_objects", **PAIR)
    assert torch.allclose(found, torch.full((3,), -DISTANCE))
    kernel = evaluated(env, "distance_between_objects", **PAIR, exponential=True, sigma=0.5)
    assert torch.allclose(kernel, torch.full((3,), math.exp(-(DISTANCE**2) / (2 * 0.25))))
    flat = evaluated(env, "distance_between_objects", **PAIR, use_xy_only=True)
    assert torch.allclose(flat, torch.full((3,), -0.3))


def test_distance_of_a_link(make) -> None:
    env = make()
    env.reset()
    found = evaluated(
        env,
        "distance_between_objects",
        source_entity_cfg=TOOL,
        target_entity_cfg={"uid": "goal"},
    )
    tool = env.robot.get_link_pose("ee_link")[0, :3].tolist()
    assert torch.allclose(found, torch.full((3,), -math.dist(tool, GOAL_POS)))


@pytest.mark.parametrize(("threshold", "expected"), [(0.55, 1.0), (0.54, 0.0)])
def test_within_distance(make, threshold, expected) -> None:
    env = make()
    env.reset()
    assert 0.54 < DISTANCE < 0.55
    found = evaluated(env, "within_distance", **PAIR, threshold=threshold)
    assert found.tolist() == [expected] * 3


def test_joint_velocity_penalty(make) -> None:
    env = make()
    env.reset()
    env.robot.set_qvel(np.tile([3.0, 4.0, 0, 0, 0, 12.0], (3, 1)), target=False)
    assert evaluated(env, "joint_velocity_penalty", **ARM).tolist() == [-13.0] * 3
    some = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint[12]"}}
    assert evaluated(env, "joint_velocity_penalty", **some).tolist() == [-5.0] * 3


def test_success_reward_follows_the_metric(make) -> None:
    env = make(
        metrics={"success": MetricCfg(func="within_distance", params={**PAIR, "threshold": 9.0})},
        rewards={"win": RewardCfg(func="success_reward", weight=10.0)},
    )
    env.reset()
    assert env.step(env.robot.get_qpos(target=True))[1].tolist() == [10.0] * 3


def test_time_out_counts_this_step(make) -> None:
    late = TerminationCfg(func="time_out", params={"time_limit_s": 0.12})
    env = make(terminations={"late": late})  # a control step is 0.04 s
    env.reset()
    home = env.robot.get_qpos(target=True)
    truncated = [env.step(home)[3].tolist() for _ in range(6)]
    assert truncated == [[False] * 3, [False] * 3, [True] * 3] * 2


def test_an_explicit_kind_of_a_time_out_wins(make) -> None:
    for kind in ("fail", "success"):
        late = TerminationCfg(func="time_out", kind=kind, params={"time_limit_s": 0.04})
        env = make(terminations={"late": late})
        env.reset()
        _, _, terminated, truncated, info = env.step(env.robot.get_qpos(target=True))
        assert terminated.all() and not truncated.any() and info[kind].all()


def test_out_of_bounds(make) -> None:
    bounds = [[-1, -1, 0], [1, 1, 1]]
    gone = TerminationCfg(func="out_of_bounds", params={**CUBE, "bounds": bounds})
    env = make(terminations={"gone": gone})
    env.reset()
    cube = env.sim.get_asset("cube")
    pose = cube.get_local_pose()
    pose[1, 0], pose[2, 2] = 1.5, 1.2
    cube.set_local_pose(pose)
    terminated = env.step(env.robot.get_qpos(target=True))[2]
    assert terminated.tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("func", "params", "part"),
    [
        ("within_distance", {**PAIR, "threshold": 0}, "greater than 0"),
        ("distance_between_objects", {**PAIR, "sigma": -1}, "greater than 0"),
        ("time_out", {"time_limit_s": -1}, "greater than 0"),
        ("out_of_bounds", {**CUBE, "bounds": [[0, 0, 0], [1, -1, 1]]}, "exceeds high -1.0"),
    ],
)
def test_ranges_are_checked(make, func, params, part) -> None:
    with pytest.raises(ConfigError, match=part):
        make(metrics={"m": MetricCfg(func=func, params=params)})
