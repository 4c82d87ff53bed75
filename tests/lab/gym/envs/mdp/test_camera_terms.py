"""Images in observations: shapes, types, groups, noise, delay, history, resets, learners' views."""

import gymnasium as gym
import numpy as np
import pytest
import torch
import yaml

import embodichain
from embodichain.utils.errors import ConfigError

TASK = """
description: A cube that falls before a wall, seen by two cameras.
max_episode_steps: 50
physics: {physics_dt: 0.02}
sim_steps_per_control: 1
robot: {uid: ur10, fpath: UniversalRobots/UR10/UR10.urdf, init_pos: [0, 5, 1]}
objects:
  wall: {shape: {shape_type: Cube, size: [0.2, 4, 4]}, body_type: static, init_pos: [1.6, 0, 1]}
  cube: {shape: {shape_type: Cube, size: [0.1, 0.1, 0.1]}, init_pos: [1.0, 0, 1.2]}
sensors:
  front: {sensor_type: camera, width: 24, height: 16, fovy: 60, data_types: [color, depth, mask],
          extrinsics: {eye: [0, 0, 1], target: [1, 0, 1]}}
  pair: {sensor_type: stereo_camera, width: 8, height: 8, observe: true, no_hit: inf,
         data_types: [color, depth, disparity, position],
         extrinsics: {eye: [0, 0, 1], target: [1, 0, 1]}}
observations:
  qpos: {func: joint_position, params: {of: {uid: ur10}}}
"""
IMAGE = {"func": "camera_image", "params": {"sensor": "front"}}


@pytest.fixture
def make(tmp_path):
    """Builds the task with further observations; keywords of `embodichain.make`."""
    built = []

    def build(observations=None, num_envs=2, **changes):
        tree = {**yaml.safe_load(TASK), **changes}
        tree["observations"] = {**tree["observations"], **(observations or {})}
        (tmp_path / "task").mkdir(exist_ok=True)
        (tmp_path / "task" / "seen.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
        env = embodichain.make("seen", num_envs, ["seed=1"], config_dir=tmp_path)
        built.append(env)
        return env

    yield build
    for env in built:
        env.close()


def hold(env):
    return torch.zeros(env.num_envs, 6)


def of(channels="color", **more):
    return {"func": "camera_image", "params": {"sensor": "front", "channels": channels}, **more}


def test_images_of_every_kind(make):
    mask = {"func": "camera_mask", "params": {"sensor": "front", "of": {"uid": "cube"}}}
    points = {"func": "camera_points", "params": {"sensor": "pair", "every": 3}}
    near = of("depth")
    near["params"] = {**near["params"], "max_depth": 3.0}
    env = make(
        {
            "color": of(),
            "depth": of("depth"),
            "near": near,
            "ids": of("mask"),
            "cube": mask,
            "points": points,
            "pose": {"func": "camera_pose", "params": {"sensor": "front"}},
            "lens": {"func": "camera_intrinsics", "params": {"sensor": "pair", "side": "right"}},
        }
    )
    obs, _ = env.reset()
    names = [name for name in obs if name not in ("robot", "sensor", "qpos")]
    found = {name: (tuple(obs[name].shape[1:]), obs[name].dtype) for name in names}
    image = (16, 24)
    assert found == {
        "color": ((3, *image), torch.uint8),
        "depth": ((1, *image), torch.float32),
        "near": ((1, *image), torch.uint8),
        "ids": ((1, *image), torch.int32),
        "cube": ((1, *image), torch.uint8),
        "points": ((9, 3), torch.float32),
        "pose": ((7,), torch.float32),
        "lens": ((4,), torch.float32),
    }
    assert obs["depth"][0, 0, 15, 0].item() == pytest.approx(1.5, abs=1e-3)
    assert obs["near"][0, 0, 15, 0] == 128  # 1.5 of 3 m
    number = env.sim.get_rigid_object("cube").entity.root_body_id
    assert set(obs["cube"].unique().tolist()) == {0, 255}
    torch.testing.assert_close(obs["cube"] == 255, obs["ids"] == number)
    wall = obs["points"][0, :, 0]
    assert wall.max().item() == pytest.approx(1.5, abs=1e-3)
    color = env.get_sensor("front").read("color")
    np.testing.assert_array_equal(obs["color"].numpy(), np.moveaxis(color[..., :3], 3, 1))
    seen = obs["sensor"]["pair"]
    assert seen["depth_right"].dtype == torch.float32
    assert seen["color"].shape == (2, 8, 8, 4)
    obs, *_, info = env.step(hold(env))  # depth is infinite beside the wall, and nothing diverges
    assert not info["diverged"].any()
    space = env.single_observation_space
    assert (space["color"].low == 0).all() and (space["color"].high == 255).all()


def test_no_image_is_in_a_flat_vector(make):
    env = make({"picture": of(), "range": of("depth")})
    obs, _ = env.reset()
    manager = env.observation_manager
    assert manager.image_terms() == ("picture", "range")
    message = "'policy' is not a flat vector: picture, range are images"
    with pytest.raises(ValueError, match=message):
        manager.flatten(obs)
    assert env.observation_buffer.last.shape == (2, 18 + 6)  # the robot's and the group's numbers
    with pytest.raises(ValueError, match="there are: policy"):
        manager.image_terms("critic")


def test_delay_and_history_keep_the_type(make):
    env = make(
        {
            "now": of(),
            "late": of(delay=2),
            "three": of(history_length=3),
            "stack": of("depth", history_length=3, flatten_history_dim=False),
        }
    )
    obs, _ = env.reset()
    past = [obs["now"]]
    for _ in range(4):
        obs, *_ = env.step(hold(env))
        past.append(obs["now"])
    assert obs["late"].dtype == obs["three"].dtype == torch.uint8
    torch.testing.assert_close(obs["late"], past[-3])
    torch.testing.assert_close(obs["three"], torch.cat(past[-3:], dim=1))
    assert obs["stack"].shape == (2, 3, 1, 16, 24)
    assert (past[-1] != past[-3]).any()  # the cube falls


def test_noise_keeps_the_type(make):
    noise = {"type": "gaussian", "std": 40.0}
    env = make({"plain": of(), "rough": of(noise=noise), "depth": of("depth", noise=noise)})
    obs, _ = env.reset()
    assert obs["rough"].dtype == torch.uint8
    assert obs["depth"].dtype == torch.float32
    difference = (obs["rough"].float() - obs["plain"].float())[obs["plain"] > 120]
    difference = difference[(difference < 60) & (difference > -60)]
    assert 25 < difference.std().item() < 40  # of what is not clipped at 255
    assert (obs["rough"][0] != obs["rough"][1]).any()


def test_after_a_reset_of_some_environments(make):
    env = make({"picture": of()}, num_envs=3)
    first, _ = env.reset()
    for _ in range(5):
        last, *_ = env.step(hold(env))
    obs, _ = env.reset(options={"reset_ids": [1]})
    changed = (first["picture"] != last["picture"]).flatten(1).any(1)
    assert changed.all()
    torch.testing.assert_close(obs["picture"][1], first["picture"][1])
    torch.testing.assert_close(obs["picture"][[0, 2]], last["picture"][[0, 2]])


def test_final_observations_keep_their_image(make):
    env = make({"picture": of()}, max_episode_steps=3)
    first, _ = env.reset()
    for _ in range(2):
        env.step(hold(env))
    obs, _, _, truncated, info = env.step(hold(env))
    assert truncated.all()
    torch.testing.assert_close(obs["picture"], first["picture"])
    assert (info["final_obs"]["picture"] != obs["picture"]).any()


def test_a_picture_depends_on_its_environment_alone(make):
    jumps = {"func": "randomize_pose", "mode": "reset"}
    jumps["params"] = {"of": {"uid": "cube"}, "position_range": [[0, -0.4, 0], [0, 0.4, 0]]}
    few = make({"picture": of()}, 2, events={"jump": jumps})
    first = few.reset()[0]["picture"].clone()
    many = make({"picture": of()}, 5, events={"jump": jumps})
    torch.testing.assert_close(many.reset()[0]["picture"][:2], first)
    assert (first[0] != first[1]).any()


def test_a_state_that_is_restored(make):
    env = make({"late": of(delay=[1, 3], history_length=2)})
    env.reset()
    env.step(hold(env))
    saved = env.state_dict()
    wanted = [env.step(hold(env))[0]["late"].clone() for _ in range(3)]
    env.load_state_dict(saved)
    for late in wanted:
        torch.testing.assert_close(env.step(hold(env))[0]["late"], late)


def test_views_for_gymnasium(make):
    env = make({"picture": of()}, num_envs=1)
    from embodichain.lab.gym.single import SingleEnv

    single = SingleEnv(env)
    assert isinstance(single.observation_space, gym.spaces.Dict)
    obs, _ = single.reset(seed=1)
    assert single.observation_space.contains(obs)
    assert obs["picture"].shape == (3, 16, 24)


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (of("colour"), "Did you mean 'color'"),
        ({"func": "camera_points", "params": {"sensor": "front"}}, "has no image 'position'"),
        ({"func": "camera_image", "params": {"sensor": "frnt"}}, "Did you mean 'front'"),
        (
            {"func": "camera_image", "params": {"sensor": "front", "max_depth": 2.0}},
            "max_depth: belongs to depth, not to color",
        ),
    ],
)
def test_mistakes(make, term, message):
    with pytest.raises(ConfigError, match=message):
        make({"wrong": term})
