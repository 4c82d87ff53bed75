"""Observations of a floating base and its links, on poses and velocities set by hand."""

import math

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.walker import walker

H = math.sqrt(0.5)
GO = {"entity_cfg": {"uid": "go"}}
FEET = {"entity_cfg": {"uid": "go", "link_names": [".*_foot"]}}
LEFT = {"uid": "go", "link_names": ["left_foot"]}


@pytest.fixture
def look(make, tmp_path):
    """Builds the walker with observations {name: (func, params)} and places it; gives the env."""

    def build(**terms):
        observations = {
            name: ObservationCfg(func=func, params=params) for name, (func, params) in terms.items()
        }
        env = make(robot=walker(tmp_path), objects={}, observations=observations)
        env.reset()
        return env

    return build


def place(env, quat, lin=(0, 0, 0), ang=(0, 0, 0)) -> None:
    """Put the root at (1, 2, 3) with an orientation, and velocities in world axes."""
    env.robot.set_local_pose(np.tile([1.0, 2.0, 3.0, *quat], (3, 1)))
    start = env.robot.entity.free_qvel_adr
    rotation = rotation_of(quat)
    row = np.concatenate([lin, rotation.T @ np.asarray(ang, float)])
    env.sim.engine.write("qvel", np.tile(row, (3, 1)), None, slice(start, start + 6))


def rotation_of(quat) -> np.ndarray:
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def same(tensor: torch.Tensor, row, atol: float = 1e-6) -> bool:
    expected = torch.tensor(row, dtype=torch.float32)
    return tensor.shape == (3, *expected.shape) and bool(
        torch.allclose(tensor, expected.expand_as(tensor), atol=atol)
    )


def test_root_and_base(look) -> None:
    env = look(
        pos=("root_pos_w", GO),
        quat=("root_quat_w", GO),
        unique=("root_quat_w", {**GO, "make_quat_unique": True}),
        lin=("root_lin_vel_w", GO),
        ang=("root_ang_vel_w", GO),
        base_lin=("base_lin_vel", GO),
        base_ang=("base_ang_vel", GO),
        down=("projected_gravity", GO),
        height=("base_height", GO),
        both=("link_velocity", GO),
        upstream=("get_rigid_object_velocity", GO),
    )
    # Turned by 90 degrees about z: its x axis is the world's y.
    place(env, (-H, 0, 0, -H), lin=(1.0, 2.0, 0.5), ang=(0.1, 0.2, 0.3))
    obs = env.get_obs()
    assert same(obs["pos"], [1.0, 2, 3])
    assert same(obs["quat"], [-H, 0, 0, -H])
    assert same(obs["unique"], [H, 0, 0, H])
    assert same(obs["lin"], [1.0, 2, 0.5])
    assert same(obs["ang"], [0.1, 0.2, 0.3])
    assert same(obs["base_lin"], [2.0, -1, 0.5])
    assert same(obs["base_ang"], [0.2, -0.1, 0.3])
    assert same(obs["down"], [0.0, 0, -1])
    assert same(obs["height"], [3.0])
    for name in ("both", "upstream"):
        assert same(obs[name], [1.0, 2, 0.5, 0.1, 0.2, 0.3])
    # Nose down by 90 degrees (about y): its x axis points straight down.
    place(env, (H, 0, H, 0))
    assert same(env.get_obs()["down"], [1.0, 0, 0])


def test_links_at_once(look) -> None:
    env = look(
        one=("link_pose", {"entity_cfg": LEFT}),
        feet=("link_pose", FEET),
        matrix=("link_pose", {**FEET, "to_matrix": True}),
        local=("link_pose", {**FEET, "in_root_frame": True}),
        root=("link_pose", GO),
        root_local=("link_pose", {**GO, "in_root_frame": True}),
    )
    place(env, (H, 0, 0, H))
    env.robot.set_qpos(np.tile([math.pi / 2, 0, 0], (3, 1)), target=False)
    obs = env.get_obs()
    # The left leg, 0.3 long, swings from straight down to straight back: -x of the trunk, which is
    # -y of the world. The left hip is at y = 0.1 of the trunk: x = -0.1 of the world.
    left = rotation_of((H, 0, 0, H)) @ np.array([-0.3, 0.1, 0]) + [1, 2, 3]
    assert np.allclose(left, [0.9, 1.7, 3])
    assert same(obs["one"][:, :3], left.tolist())
    assert obs["feet"].shape == (3, 2, 7)
    assert torch.equal(obs["feet"][:, 0], obs["one"])
    assert same(obs["feet"][:, 1], [1.1, 2, 2.7, H, 0, 0, H])
    assert same(obs["local"], [[-0.3, 0.1, 0, H, 0, H, 0], [0, -0.1, -0.3, 1, 0, 0, 0]])
    assert same(obs["matrix"][:, 1, :3, :3], rotation_of((H, 0, 0, H)).tolist())
    assert same(obs["matrix"][:, 1, :, 3], [1.1, 2, 2.7, 1])
    assert same(obs["root"], [1.0, 2, 3, H, 0, 0, H])
    assert same(obs["root_local"], [0.0, 0, 0, 1, 0, 0, 0])


def test_velocities_of_links(look) -> None:
    env = look(
        one=("link_velocity", {"entity_cfg": LEFT}),
        feet=("link_velocity", FEET),
        local=("link_velocity", {**FEET, "in_root_frame": True}),
    )
    place(env, (H, 0, 0, H), lin=(1, 0, 0), ang=(0, 0, 2))
    env.robot.set_qvel(np.tile([0.0, 4.0, 0.0], (3, 1)), target=False)
    obs = env.get_obs()
    # Feet at (-+0.1, 0, -0.3) from the root in world axes; v = v0 + w x r.
    assert same(obs["one"], [1.0, -0.2, 0, 0, 0, 2], atol=1e-5)
    # The right hip turns by 4 rad/s about the trunk's y, which is the world's -x:
    # (-4, 0, 0) x (0, 0, -0.3) = (0, -1.2, 0).
    assert same(obs["feet"][:, 1], [1.0, 0.2 - 1.2, 0, -4, 0, 2], atol=1e-5)
    # Minus the root's velocity, in the trunk's axes (x' = y, y' = -x).
    expected = [[-0.2, 0, 0, 0, 0, 0], [-1.0, 0, 0, 0, 4, 0]]
    assert same(obs["local"], expected, atol=1e-5)


def test_a_single_link_takes_the_roots_place(look) -> None:
    env = look(
        pos=("root_pos_w", {"entity_cfg": LEFT}), height=("base_height", {"entity_cfg": LEFT})
    )
    place(env, (1, 0, 0, 0))
    obs = env.get_obs()
    assert same(obs["pos"], [1.0, 2.1, 2.7]) and same(obs["height"], [2.7])


def test_orientation_and_yaw(look) -> None:
    env = look(
        quat=("orientation", {**GO, "representation": "quat"}),
        matrix=("orientation", {**GO, "representation": "matrix"}),
        six=("orientation", GO),
        yaw=("yaw", GO),
        sin_cos=("yaw", {**GO, "representation": "sin_cos"}),
    )
    angle = -2.5  # about z
    quat = (-math.cos(angle / 2), 0, 0, -math.sin(angle / 2))
    place(env, quat)
    obs = env.get_obs()
    c, s = math.cos(angle), math.sin(angle)
    assert same(obs["quat"], [-q for q in quat])
    assert same(obs["matrix"], [[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert same(obs["six"], [c, s, 0, -s, c, 0])
    assert same(obs["yaw"], [angle])
    assert same(obs["sin_cos"], [s, c])
    place(env, (H, 0, H, 0))  # nose down: no heading
    obs = env.get_obs()
    assert torch.allclose(obs["sin_cos"].norm(dim=1), torch.ones(3))


def test_joint_observations(look) -> None:
    legs = {"entity_cfg": {"uid": "go", "joint_names": ".*_hip"}}
    env = look(
        pos=("joint_position", GO),
        share=("joint_pos_limit_normalized", legs),
        effort=("joint_effort", GO),
    )
    env.robot.set_qpos(np.tile([0.5, 2.0, 0.0], (3, 1)), target=False)
    assert same(env.get_obs()["share"], [0.0, 1.0])
    env.robot.drives.write_limit(
        1, np.full((1, 1), 1.0), np.array([1]), np.array([0])
    )  # environment 1: [-1, 1]
    assert torch.allclose(env.get_obs()["share"][:, 0], torch.tensor([0.0, 0.5, 0.0]))
    env.robot.set_qpos(np.tile([0.1, 0.0, 0.0], (3, 1)))  # targets
    obs = env.step(torch.zeros(3, 3))[0]
    assert torch.allclose(obs["effort"], env.robot.body_data.qf)
    env.robot.set_qf(np.full((3, 3), 2.0))
    assert torch.allclose(env.get_obs()["effort"], obs["effort"] + 2.0, atol=1e-6)


def test_a_joint_without_limits_is_named(look) -> None:
    with pytest.raises(ConfigError, match="without position limits: spin"):
        look(share=("joint_pos_limit_normalized", GO))
