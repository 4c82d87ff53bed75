"""Rewards of distances, orientations and progress, on cases worked by hand."""

import inspect
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import EventCfg, RewardCfg
from embodichain.lab.gym.envs.managers import TERMS
from embodichain.utils.errors import ConfigError
from tests.helpers.judging import put, reward, turned
from tests.helpers.ur10_task import builder

CUBE, GOAL = {"uid": "cube"}, {"uid": "goal"}
PAIR = {"source_entity_cfg": CUBE, "target_entity_cfg": GOAL}
TARGET = (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def scene() -> Iterator[Any]:
    """The cube 0.3, 0.4, 1.2 away from a goal: 0.5 in the plane, 1.3 in space."""
    with builder() as build:
        env = build()
        env.reset()
        put(env, "goal", TARGET)
        put(env, "cube", (0.7, 0.6, 2.2))
        env.target_pose = torch.eye(4).repeat(3, 1, 1)
        env.target_pose[:, :3, 3] = torch.tensor(TARGET)
        yield env


def test_distance_to_target(scene) -> None:
    source = {"source_entity_cfg": CUBE}
    assert reward(scene, "distance_to_target", **source) == pytest.approx([-1.3] * 3)
    assert reward(scene, "distance_to_target", **source, use_xy_only=True) == pytest.approx(
        [-0.5] * 3
    )
    near = reward(scene, "distance_to_target", **source, exponential=True, sigma=1.3)
    assert near == pytest.approx([math.exp(-0.5)] * 3)


def test_a_target_that_nobody_writes_is_an_error_that_says_who_could(scene) -> None:
    params = {"source_entity_cfg": CUBE, "target_pose_key": "gaol_pose"}
    with pytest.raises(ConfigError, match="no poses 'gaol_pose'.*randomize_target_pose"):
        reward(scene, "distance_to_target", **params)
    scene.gaol_pose = torch.zeros(3, 7)
    with pytest.raises(ValueError, match=r"shape \(3, 4, 4\) or \(3, 3\), got \(3, 7\)"):
        reward(scene, "distance_to_target", **params)


def test_a_target_may_appear_at_the_first_reset(make) -> None:
    def place(env: Any, env_ids: Any) -> None:
        env.place = torch.eye(4).repeat(env.num_envs, 1, 1)

    params = {"source_entity_cfg": GOAL, "target_pose_key": "place"}
    env = make(
        events={"place": EventCfg(func=place)},
        rewards={"r": RewardCfg(func="distance_to_target", params=params)},
    )
    env.reset()
    expected = -math.dist((0.5, 0.2, 0.5), (0, 0, 0))
    assert env.step(env.robot.get_qpos(target=True))[1].tolist() == pytest.approx([expected] * 3)


def test_tanh_kernels(scene) -> None:
    assert reward(scene, "distance_tanh", **PAIR, std=0.65) == pytest.approx([1 - math.tanh(2)] * 3)
    flat = reward(scene, "distance_tanh", **PAIR, std=0.25, use_xy_only=True)
    assert flat == pytest.approx([1 - math.tanh(2)] * 3)


def test_object_goal_distance_pays_only_above_the_height(scene) -> None:
    pair = {"object_cfg": CUBE, "goal_cfg": GOAL, "std": 1.3}
    expected = [1 - math.tanh(1)] * 3
    assert reward(scene, "object_goal_distance", **pair, minimal_height=2.1) == pytest.approx(
        expected
    )
    assert reward(scene, "object_goal_distance", **pair, minimal_height=2.2) == [0.0] * 3


def test_reaching_behind_the_object(scene) -> None:
    """The target is at distance 1.3, so the unit vector is (0.3, 0.4, -1.2) / 1.3."""
    tool = scene.robot.get_link_pose("ee_link")[0, :3].double().numpy()
    unit = np.array([0.3, 0.4, -1.2]) / 1.3
    wanted = np.array([0.7, 0.6, 2.2]) - 0.13 * unit + np.array([0, 0, 0.02])
    expected = 1 - math.tanh(2.0 * float(np.linalg.norm(tool - wanted)))
    params = {
        "object_cfg": CUBE,
        "target_pose_key": "target_pose",
        "behind_offset": 0.13,
        "height_offset": 0.02,
        "distance_scale": 2.0,
    }
    found = reward(scene, "reaching_behind_object", **params)
    assert found == pytest.approx([expected] * 3, abs=1e-6)
    link = {"end_effector_cfg": {"uid": "ur10", "link_names": ["ee_link"]}}
    assert reward(scene, "reaching_behind_object", **params, **link) == found
    other = {"end_effector_cfg": {"uid": "ur10", "link_names": ["base_link"]}}
    assert reward(scene, "reaching_behind_object", **params, **other) != found
    with pytest.raises(ConfigError, match="part_name"):
        reward(scene, "reaching_behind_object", **params, **link, part_name="arm")


def test_reaching_behind_an_object_that_has_arrived_is_a_number(scene) -> None:
    put(scene, "cube", TARGET)
    found = reward(scene, "reaching_behind_object", object_cfg=CUBE, target_pose_key="target_pose")
    assert all(0 < value < 1 for value in found)
    put(scene, "cube", (0.7, 0.6, 2.2))


@pytest.mark.parametrize(("degrees", "cosine"), [(0, 1.0), (60, 0.5), (90, 0.0), (180, -1.0)])
def test_orientations_are_compared_by_one_angle(scene, degrees, cosine) -> None:
    angle = math.radians(degrees)
    axis = np.array([2, -1, 2]) / 3
    put(scene, "goal", TARGET, turned([0, 0, 1], 0.7))
    put(scene, "cube", (0.7, 0.6, 2.2), _times(turned([0, 0, 1], 0.7), turned(axis, angle)))
    assert reward(scene, "orientation_alignment", **PAIR) == pytest.approx([cosine] * 3, abs=1e-6)
    assert reward(scene, "orientation_error", **PAIR) == pytest.approx([angle] * 3, abs=1e-6)
    kernel = reward(scene, "orientation_tanh", **PAIR, std=0.5)
    assert kernel == pytest.approx([1 - math.tanh(2 * angle)] * 3, abs=1e-6)


def _times(a: Any, b: Any) -> list[float]:
    from scipy.spatial.transform import Rotation

    first, second = (Rotation.from_quat(q, scalar_first=True) for q in (a, b))
    return (first * second).as_quat(scalar_first=True).tolist()


def test_the_sign_of_a_quaternion_means_nothing(scene) -> None:
    put(scene, "goal", TARGET, [1, 0, 0, 0])
    put(scene, "cube", (0.7, 0.6, 2.2), [-1, 0, 0, 0])
    assert reward(scene, "orientation_error", **PAIR) == [0.0] * 3
    assert reward(scene, "orientation_alignment", **PAIR) == [1.0] * 3


def test_progress_is_paid_by_its_sign_and_forgotten_at_resets(make) -> None:
    params = {
        "source_entity_cfg": GOAL,
        "target_pose_key": "place",
        "tanh_scale": 2.0,
        "positive_weight": 3.0,
        "negative_weight": 5.0,
    }
    env = make(
        extensions={"place": torch.eye(4).repeat(3, 1, 1)},
        rewards={"r": RewardCfg(func="incremental_distance_to_target", params=params)},
    )
    env.reset()

    def paid(*heights: float) -> list[float]:
        put(env, "goal", [(0, 0, height) for height in heights])
        return env.step(env.robot.get_qpos(target=True))[1].tolist()

    assert paid(1.0, 1.0, 1.0) == [0.0] * 3
    gain = math.tanh(2 * 0.25)
    assert paid(0.75, 1.25, 1.0) == pytest.approx([3 * gain, -5 * gain, 0.0])
    saved = env.state_dict()
    expected = [3 * math.tanh(0.5), 3 * math.tanh(1.0), 0.0]
    assert paid(0.5, 0.75, 1.0) == pytest.approx(expected)
    env.load_state_dict(saved)
    assert paid(0.5, 0.75, 1.0) == pytest.approx(expected)
    env.reset(options={"reset_ids": [1]})
    # No spike where the goal jumped in between; the others go on.
    assert paid(0.5, 9.0, 0.75) == pytest.approx([0.0, 0.0, 3 * math.tanh(0.5)])


def test_progress_in_the_plane_only(make) -> None:
    params = {"source_entity_cfg": GOAL, "target_pose_key": "place", "use_xy_only": True}
    env = make(
        extensions={"place": torch.eye(4).repeat(3, 1, 1)},
        rewards={"r": RewardCfg(func="incremental_distance_to_target", params=params)},
    )
    env.reset()
    for pos, paid in [((1, 0, 1), 0.0), ((1, 0, 5), 0.0), ((0.9, 0, 5), math.tanh(1.0))]:
        put(env, "goal", pos)
        reward_ = env.step(env.robot.get_qpos(target=True))[1]
        assert reward_.tolist() == pytest.approx([paid] * 3)


NEEDED = object()
# EmbodiChain's published signatures; our robot_uid None is the task's robot, whatever its name.
UPSTREAM = {
    "distance_between_objects": {
        "source_entity_cfg": NEEDED,
        "target_entity_cfg": NEEDED,
        "exponential": False,
        "sigma": 1.0,
    },
    "distance_to_target": {
        "source_entity_cfg": NEEDED,
        "target_pose_key": "target_pose",
        "exponential": False,
        "sigma": 1.0,
        "use_xy_only": False,
    },
    "incremental_distance_to_target": {
        "source_entity_cfg": NEEDED,
        "target_pose_key": "target_pose",
        "tanh_scale": 10.0,
        "positive_weight": 1.0,
        "negative_weight": 1.0,
        "use_xy_only": False,
    },
    "orientation_alignment": {"source_entity_cfg": NEEDED, "target_entity_cfg": NEEDED},
    "reaching_behind_object": {
        "object_cfg": NEEDED,
        "target_pose_key": "goal_pose",
        "behind_offset": 0.015,
        "height_offset": 0.015,
        "distance_scale": 5.0,
        "part_name": None,
    },
    "success_reward": {},
    "joint_velocity_penalty": {"robot_uid": None, "joint_ids": None, "part_name": None},
    "action_smoothness_penalty": {},
    "joint_limit_penalty": {"robot_uid": None, "joint_ids": None, "margin": 0.1},
}


@pytest.mark.parametrize("name", sorted(UPSTREAM))
def test_embodichains_rewards_keep_their_parameters_and_defaults(name) -> None:
    spec = TERMS["reward"][name]
    words = spec.written(UPSTREAM[name])  # EmbodiChain's name -> ours
    defaults = {key: spec.params[words[key]].default for key in UPSTREAM[name]}
    required = inspect.Parameter.empty
    found = {key: NEEDED if value is required else value for key, value in defaults.items()}
    assert found == UPSTREAM[name]
    added = [param for key, param in spec.params.items() if key not in words.values()]
    assert all(parameter.default is not inspect.Parameter.empty for parameter in added)
