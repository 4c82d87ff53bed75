"""Learning from images: spaces, one update of PPO, saving, loading, mistakes."""

import numpy as np
import pytest
import torch
import yaml
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.vec_env import VecTransposeImage

import embodichain
from embodichain.config import resolve
from embodichain.lab.gym.single import SingleEnv
from embodichain.learning import SB3VecEnv, load_policy
from embodichain.learning.sb3.extractors import SmallCnn
from embodichain.learning.training.train import train
from embodichain.utils.errors import ConfigError
from tests.learning.recorded import record

pytestmark = pytest.mark.slow

TASK = """
description: A goal that a camera sees.
max_episode_steps: 5
robot: {uid: ur10, fpath: UniversalRobots/UR10/UR10.urdf, init_pos: [0, 0, 1]}
objects:
  goal: {shape: {shape_type: Sphere, radius: 0.2}, body_type: kinematic,
         attrs: {enable_collision: false}, init_pos: [1, 0, 1]}
sensors:
  front: {sensor_type: camera, width: 36, height: 36, fovy: 60,
          extrinsics: {eye: [2, -2, 2], target: [0.5, 0, 0.8]}}
observations:
  front: {func: camera_image, params: {sensor: front}}
  qpos: {func: joint_position, params: {of: {uid: ur10}}}
  alone: {func: camera_image, params: {sensor: front}, group: alone}
rewards:
  still: {func: action_l2, weight: -1.0}
"""
SMALL = {"n_steps": 4, "batch_size": 8, "n_epochs": 1, "device": "cpu", "seed": 0}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "conf" / "task").mkdir(parents=True)
    (tmp_path / "conf" / "task" / "seen.yaml").write_text(TASK)
    monkeypatch.chdir(tmp_path)  # ./conf is found there
    return tmp_path


@pytest.fixture
def env(folder):
    env = embodichain.make("seen", 4, ["seed=1"])
    yield env
    env.close()


def test_a_dict_of_image_and_numbers(env):
    vec_env = SB3VecEnv(env, flatten=False)
    space = vec_env.observation_space
    assert isinstance(space, spaces.Dict) and list(space) == ["front", "qpos"]
    assert is_image_space(space["front"]) and space["front"].shape == (3, 36, 36)
    obs = vec_env.reset()
    assert obs["front"].dtype == np.uint8 and obs["front"].shape == (4, 3, 36, 36)
    kwargs = {"features_extractor_class": SmallCnn, "features_extractor_kwargs": {"features": 8}}
    model = PPO("MultiInputPolicy", vec_env, policy_kwargs=kwargs, **SMALL)
    assert not isinstance(model.get_env(), VecTransposeImage)
    assert model.policy.features_extractor.features_dim == 8 + 6
    before = [p.clone() for p in model.policy.features_extractor.parameters()]
    model.learn(16)
    assert model.rollout_buffer.observations["front"].dtype == np.uint8
    after = list(model.policy.features_extractor.parameters())
    assert all((a != b).any() for a, b in zip(before, after, strict=True))


def test_entries_on_another_device_are_copied_once(env, monkeypatch):
    """Packed into one tensor, entries are as those copied one by one, and are the caller's."""
    env.reset()
    obs, *others, _ = env.step(torch.ones(4, 6))
    numpy, copies = torch.Tensor.numpy, []

    def counted(tensor, **kwargs):
        copies.append(tensor.numel())
        return numpy(tensor, **kwargs)

    for vec_env in (SB3VecEnv(env, flatten=False), SB3VecEnv(env, "alone")):
        # Arrays of a device are sent in one piece; those of the CPU, without packing, are the same.
        wanted = vec_env._on_host(obs, *others[:3])
        vec_env._packs = True
        copies.clear()
        with monkeypatch.context() as patch:
            # Copies to the host show only in their time.
            patch.setattr(torch.Tensor, "numpy", counted)
            found = vec_env._on_host(obs, *others[:3])
        assert sum(map(bool, copies)) == 1
        entries = [part if isinstance(part, dict) else {"": part} for part in (wanted[0], found[0])]
        for a, b in zip(entries[0].values(), entries[1].values(), strict=True):
            assert a.dtype == b.dtype and a.flags.aligned and b.flags.aligned
            np.testing.assert_array_equal(a, b)
            b[:] = 0
        for a, b in zip(wanted[1:], found[1:], strict=True):
            np.testing.assert_array_equal(a, b)
    assert obs["front"].any()


def test_an_image_alone_is_for_a_cnn_policy(env):
    vec_env = SB3VecEnv(env, "alone")
    assert is_image_space(vec_env.observation_space)
    model = PPO("CnnPolicy", vec_env, **SMALL)
    assert not isinstance(model.get_env(), VecTransposeImage)
    obs = vec_env.reset()
    np.testing.assert_array_equal(obs, env.get_obs()["alone"].numpy())
    assert model.predict(obs)[0].shape == (4, 6)


def test_terminal_observations_have_images(env):
    vec_env = SB3VecEnv(env, flatten=False)
    vec_env.reset()
    for _ in range(5):
        obs, _, dones, infos = vec_env.step(np.full((4, 6), 0.8))
    assert dones.all()
    last = infos[2]["terminal_observation"]
    assert last["front"].shape == (3, 36, 36) and last["front"].dtype == np.uint8
    assert (last["front"] != obs["front"][2]).any()


def test_a_flat_group_is_refused_with_the_term(env):
    with pytest.raises(ConfigError, match="'policy' is not a flat vector: front is an image"):
        SB3VecEnv(env)


def test_the_checker_of_gymnasium_environments(folder):
    env = embodichain.make("seen", 1, ["seed=1"])
    check_env(SingleEnv(env), warn=False)
    env.close()


def test_networks_that_take_vectors_are_refused(folder):
    with pytest.raises(ConfigError, match="algo: its networks take vectors, and front in group "):
        train(resolve(["task=seen", "algo=rsl_rl_ppo", "total_timesteps=16"], "train"), folder)


ALGO = ["algo.n_steps=4", "algo.batch_size=8", "algo.n_epochs=1", "num_envs=4", "eval.episodes=0"]
LINES = ["task=seen", "total_timesteps=16", *ALGO]


def test_train_and_load(folder):
    lines = [
        *LINES,
        "algo.policy=MultiInputPolicy",
        "algo.policy_kwargs={features_extractor_class: small_cnn, net_arch: [16]}",
    ]
    run = folder / "run"
    run.mkdir()
    summary = train(resolve(lines, "train"), run)
    assert (summary.env_steps, summary.status) == (16, "finished")
    with_images = embodichain.make("seen", 2, ["seed=1"])
    policy = load_policy(run / summary.checkpoint, with_images)
    obs, _ = with_images.reset()
    actions = policy(obs, with_images)
    assert actions.shape == (2, 6)
    policy.reset(None)
    np.testing.assert_array_equal(policy(obs, with_images), actions)
    with_images.close()
    tree = yaml.safe_load(TASK)
    tree["sensors"]["front"]["width"] = 40
    (folder / "conf" / "task" / "wide.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    wide = embodichain.make("wide", 2, ["seed=1"])
    with pytest.raises(ConfigError, match=r"'front': \(3, 36, 36\).*this task has .*\(3, 36, 40\)"):
        load_policy(run / summary.checkpoint, wide)
    wide.close()


def test_cloning_from_images(folder):
    lines = ["task=seen", "num_envs=2", "seed=1", "total_timesteps=64", "dataset=conf", "algo=bc"]
    lines += ["algo.policy=MultiInputPolicy", "algo.chunk_size=2", "algo.batch_size=8"]
    run = folder / "run"
    run.mkdir()
    resolved = resolve([*lines, "algo.validation_share=0"], "train")
    summary = train(
        resolved, run, episodes=lambda env: record(env, lambda obs: np.cos(obs["qpos"]), 4)
    )
    assert (summary.demonstrations, summary.episodes) == (2, 2 * 8)
    env = embodichain.make("seen", 2, ["seed=1"])
    policy = load_policy(run, env)
    assert isinstance(policy.model.policy.features_extractor, SmallCnn)
    seen = policy.observed(env.reset()[0], env)
    plan = policy.plan(seen)
    assert plan.shape == (2, 2, 6)
    assert np.abs(policy.plan({**seen, "front": 255 - seen["front"]}) - plan).max() > 1e-4
    assert np.abs(policy.plan({**seen, "qpos": seen["qpos"] + 1}) - plan).max() > 1e-4
    env.close()


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            [],
            "algo.policy: .*front is an image; .* Write algo.policy=MultiInputPolicy, or in",
        ),
        (
            ["algo.policy=CnnPolicy", "algo.normalize=obs", "~task.observations.qpos"],
            "algo.normalize: an observation of images is not normalized",
        ),
        (["algo.policy_kwargs={features_extractor_class: smal_cnn}"], "Did you mean 'small_cnn'"),
        (["algo=crossq", "algo.policy=CnnPolicy"], "algo.policy: crossq has no CnnPolicy"),
    ],
)
def test_mistakes(folder, lines, message):
    lines = [
        line for line in [*LINES, *lines] if "crossq" not in "".join(lines) or "n_" not in line
    ]
    with pytest.raises(ConfigError, match=message):
        train(resolve(lines, "train"), folder)
