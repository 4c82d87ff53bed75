"""A critic with observation groups of its own: training, acting without them, files, mistakes."""

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import embodichain
from embodichain.config import resolve
from embodichain.learning import SB3VecEnv, evaluate, export_policy, load_policy
from embodichain.learning.policies.exported import load_exported
from embodichain.learning.policies.exporting import FORMATS
from embodichain.learning.policies.policy import load_model
from embodichain.learning.sb3.asymmetric import AsymmetricActorCriticPolicy
from embodichain.learning.sb3.normalization import NormalizeStatistics, load_statistics
from embodichain.learning.training.train import train
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow

# The actor has joints and its last action, the critic the way to the goal too.
STATE = ["task.observations.to_goal.group=critic", "task.max_episode_steps=7"]
DEPLOYED = ["~task.observations.to_goal", "task.max_episode_steps=7", "seed=5"]
CAMERA = [
    "+task.sensors.front={sensor_type: camera, width: 36, height: 36, "
    "extrinsics: {eye: [2, -2, 2], target: [0, 0, 1]}}",
    "+task.observations.front={func: camera_image, params: {sensor: front}}",
]
LINES = ["task=reach", *STATE, "num_envs=4", "sim.num_threads=1", "seed=1", "eval.episodes=0"]
DICT = ["algo.policy=MultiInputPolicy", "algo.critic_groups=[policy,critic]"]
PPO_LINES = ["algo.n_steps=8", "algo.batch_size=16", "algo.n_epochs=2"]
A2C_LINES = ["algo=a2c", "algo.n_steps=8"]
OFF = ["algo.learning_starts=16", "algo.buffer_size=200", "algo.batch_size=8"]
STEP_32 = "step_000000000032.zip"
STEPS = "total_timesteps=64"
ACTOR, CRITIC = {"qpos", "qvel", "action"}, {"qpos", "qvel", "action", "to_goal"}


def trained(folder, *lines):
    folder.mkdir()
    summary = train(resolve([*LINES, *DICT, STEPS, *lines], "train"), folder)
    return folder / summary.checkpoint


def rows(count=3, seed=0):
    rng = np.random.default_rng(seed)
    return {k: rng.normal(size=(count, 3 if k == "to_goal" else 6)) for k in sorted(CRITIC)}


def float32(obs):
    return {key: np.float32(value) for key, value in obs.items()}


@pytest.fixture(scope="module")
def normalized(tmp_path_factory):
    """The checkpoint of a short training with PPO, observations and rewards normalized."""
    folder = tmp_path_factory.mktemp("training") / "run"
    return trained(folder, *PPO_LINES, "algo.normalize=both")


@pytest.fixture
def env():
    env = embodichain.make("reach", 3, [*STATE, "seed=1"])
    yield env
    env.close()


def test_the_vector_environment_has_both_views(env):
    vec_env = SB3VecEnv(env, flatten=False, critic_groups=["policy", "critic"])
    assert set(vec_env.actor_keys) == ACTOR and set(vec_env.critic_keys) == CRITIC
    assert set(vec_env.observation_space.spaces) == CRITIC
    obs = vec_env.reset()
    np.testing.assert_array_equal(obs["to_goal"], env.get_obs()["to_goal"].numpy())
    for _ in range(7):
        _, _, _, infos = vec_env.step(np.zeros((3, 6)))
    assert infos[1]["terminal_observation"]["to_goal"].shape == (3,)
    alone = SB3VecEnv(env, flatten=False)
    assert set(alone.observation_space.spaces) == ACTOR
    assert alone.critic_keys == alone.actor_keys
    with pytest.raises(ConfigError, match="several groups is a dict: use flatten=False"):
        SB3VecEnv(env, critic_groups=["critic"])


@pytest.mark.parametrize(
    "algo",
    [None, A2C_LINES, ["algo=sac", *OFF], ["algo=td3", *OFF], ["algo=ddpg", *OFF]],
    ids=["ppo", "a2c", "sac", "td3", "ddpg"],
)
def test_the_action_depends_on_the_actors_entries_alone(tmp_path, normalized, algo):
    policy = load_policy(trained(tmp_path / "run", *algo) if algo else normalized)
    obs = float32(rows())
    actions = policy.predict(obs)
    garbage = {**obs, "to_goal": np.full((3, 3), np.nan, np.float32)}
    np.testing.assert_array_equal(policy.predict(garbage), actions)
    without = {key: value for key, value in obs.items() if key != "to_goal"}
    np.testing.assert_array_equal(policy.predict(without), actions)
    assert (policy.predict({**obs, "qpos": obs["qpos"] + 1}) != actions).any()


def test_trpo_has_two_views(tmp_path):
    pytest.importorskip("sb3_contrib")
    lines = ["algo=trpo", "algo.n_steps=8", "algo.batch_size=16"]
    policy = load_policy(trained(tmp_path / "run", *lines))
    obs = float32(rows())
    assert np.isfinite(policy.predict({k: obs[k] for k in ACTOR})).all()


def test_the_value_depends_on_the_critics_entries_alone(tmp_path):
    """With the group `critic` alone the value reads nothing else, and both networks learn."""
    lines = ["algo.critic_groups=[critic]", *PPO_LINES, "checkpoint.every_steps=32"]
    path = trained(tmp_path / "run", *lines)
    before, model = (load_model(p).model for p in (path.with_name(STEP_32), path))
    obs, other = ({k: torch.from_numpy(v) for k, v in float32(rows(3, s)).items()} for s in (0, 1))
    values = model.policy.predict_values({"to_goal": obs["to_goal"]})
    assert torch.equal(model.policy.predict_values({**other, "to_goal": obs["to_goal"]}), values)
    assert (model.policy.predict_values(other) != values).all()
    _, of_forward, _ = model.policy({**other, "to_goal": obs["to_goal"]})
    assert torch.equal(of_forward, values)
    for name in ("value_net", "policy_net"):
        pairs = zip(
            getattr(before.policy.mlp_extractor, name).parameters(),
            getattr(model.policy.mlp_extractor, name).parameters(),
            strict=True,
        )
        assert all((a != b).any() for a, b in pairs)


def test_a_task_without_the_critics_group_plays_the_policy(normalized):
    found = []
    for lines in ([*STATE, "seed=5"], DEPLOYED):
        env = embodichain.make("reach", 3, lines)
        policy = load_policy(normalized, env)
        obs, _ = env.reset(seed=5)
        found.append(policy(obs, env).numpy())
        assert evaluate(env, policy, episodes=3).length.mean == 7
        env.close()
    np.testing.assert_array_equal(*found)


def test_resumed_equals_uninterrupted(tmp_path, normalized):
    lines = [*PPO_LINES, "algo.normalize=both", "total_timesteps=128"]
    whole = trained(tmp_path / "whole", *lines)
    second = trained(tmp_path / "second", *lines, f"resume={normalized.parents[1]}")
    states = [load_model(path).model.policy.state_dict() for path in (whole, second)]
    for name, value in states[0].items():
        assert torch.equal(states[1][name], value), name
    kept = [load_statistics(path.with_suffix(".normalize.npz")) for path in (whole, second)]
    assert set(kept[0].obs_mean) == CRITIC
    for name in CRITIC:
        np.testing.assert_array_equal(kept[0].obs_mean[name], kept[1].obs_mean[name])
        np.testing.assert_array_equal(kept[0].obs_var[name], kept[1].obs_var[name])


def test_a_replay_buffer_of_a_dict_goes_on(tmp_path):
    lines = ["algo=sac", *OFF, "algo.train_freq=4", "checkpoint.replay_buffer=true"]
    whole = trained(tmp_path / "whole", *lines, "total_timesteps=128")
    trained(tmp_path / "first", *lines)
    second = trained(
        tmp_path / "second", *lines, "total_timesteps=128", f"resume={tmp_path / 'first'}"
    )
    states = [load_model(path).model.policy.state_dict() for path in (whole, second)]
    assert all(torch.equal(states[1][name], value) for name, value in states[0].items())


def test_numbers_beside_images_are_normalized(tmp_path):
    lines = [*CAMERA, *PPO_LINES, "algo.normalize=obs", "num_envs=2", "total_timesteps=32"]
    small = "algo.policy_kwargs={features_extractor_class: small_cnn, net_arch: [8]}"
    path = trained(tmp_path / "run", *lines, small)
    policy = load_policy(path)
    assert policy.statistics.shape == {k: (3 if k == "to_goal" else 6,) for k in CRITIC}
    obs = {**float32(rows(2)), "front": np.full((2, 3, 36, 36), 200, np.uint8)}
    shown = policy.statistics.normalize(obs)
    assert shown["front"] is obs["front"]
    mean, variance = policy.statistics.obs_mean["qpos"], policy.statistics.obs_var["qpos"]
    expected = np.clip((obs["qpos"] - mean) / np.sqrt(variance + 1e-8), -10, 10)
    np.testing.assert_allclose(shown["qpos"], expected, rtol=1e-6)
    with pytest.raises(ConfigError, match="reads images; only policies that read numbers"):
        export_policy(policy, None, tmp_path / "policy.pt", "torchscript")


def test_statistics_are_those_of_vecnormalize(env, tmp_path):
    vec_env = VecNormalize(SB3VecEnv(env, flatten=False, critic_groups=["critic"]), clip_obs=1.5)
    vec_env.reset()
    for _ in range(5):
        vec_env.step(np.random.default_rng(0).uniform(-1, 1, (3, 6)))
    raw = vec_env.get_original_obs()
    found, wanted = NormalizeStatistics.of(vec_env).normalize(raw), vec_env.normalize_obs(raw)
    for name in CRITIC:
        np.testing.assert_array_equal(found[name], wanted[name])


@pytest.mark.parametrize("form", FORMATS)
def test_export_writes_the_actor(tmp_path, normalized, form):
    path = normalized if form == "onnx" else trained(tmp_path / "run", *PPO_LINES)
    env = embodichain.make("reach", 3, DEPLOYED)
    policy = load_policy(path, env)
    out = tmp_path / f"policy{FORMATS[form]}"
    assert export_policy(policy, env, out, form) <= 1e-4
    exported = load_exported(out)
    assert exported.metadata.columns[0] == "qpos[0]" and len(exported.metadata.columns) == 18
    exported.check(env)
    obs, _ = env.reset(seed=5)
    actions = exported(obs, env).numpy()
    np.testing.assert_allclose(actions, policy(obs, env).numpy(), atol=1e-5)
    env.close()


def test_the_policy_in_python(env):
    vec_env = SB3VecEnv(env, flatten=False, critic_groups=["critic"])
    keys = {"actor_keys": vec_env.actor_keys, "critic_keys": vec_env.critic_keys}
    kwargs = {**keys, "net_arch": {"pi": [8], "vf": [5, 4]}}
    model = PPO(
        AsymmetricActorCriticPolicy,
        vec_env,
        n_steps=4,
        batch_size=6,
        n_epochs=1,
        policy_kwargs=kwargs,
        device="cpu",
    ).learn(12)
    first = [
        net[0].in_features
        for net in (model.policy.mlp_extractor.policy_net, model.policy.mlp_extractor.value_net)
    ]
    assert first == [18, 3] and model.policy.value_net.in_features == 4


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            ["algo.critic_groups=[critc]"],
            "algo.critic_groups: no observation is in group 'critc'; there are: policy, critic.*"
            "Did you mean 'critic'",
        ),
        (["algo.critic_groups=[]"], "algo.critic_groups: "),
        (["algo.policy=MlpPolicy"], "algo.critic_groups: .*algo.policy=MultiInputPolicy"),
        (
            ["algo=recurrent_ppo", "algo.policy=MultiInputLstmPolicy"],
            "algo.critic_groups: recurrent_ppo has one view.*ppo, a2c",
        ),
        (["algo=tqc"], "algo.critic_groups: tqc has one view of the observation"),
        (
            ["algo.policy_kwargs={share_features_extractor: true}"],
            "algo.policy_kwargs.share_features_extractor: ",
        ),
        (
            [f"task.observations.{name}.group=critic" for name in ACTOR],
            "no observation is in group 'policy'; there are: critic",
        ),
    ],
)
def test_mistakes(tmp_path, lines, message):
    if any(name in lines[0] for name in ("recurrent", "tqc")):
        pytest.importorskip("sb3_contrib")
    with pytest.raises(ConfigError, match=message):
        train(resolve([*LINES, *DICT, STEPS, *lines], "train"), tmp_path)
