"""Every algorithm's zip is told from its attributes alone."""

import gymnasium as gym
import pytest

from embodichain.learning.checkpoints.checkpoint import made_by, read_note

NAMES = {
    "ppo": "stable_baselines3.PPO",
    "a2c": "stable_baselines3.A2C",
    "sac": "stable_baselines3.SAC",
    "td3": "stable_baselines3.TD3",
    "ddpg": "stable_baselines3.DDPG",
    "dqn": "stable_baselines3.DQN",
    "tqc": "sb3_contrib.TQC",
    "crossq": "sb3_contrib.CrossQ",
    "trpo": "sb3_contrib.TRPO",
    "recurrent_ppo": "sb3_contrib.RecurrentPPO",
    "bc": "embodichain.learning.cloning.BehaviorCloning",
}


@pytest.mark.parametrize("name", NAMES)
def test_zip_tells_its_algorithm(tmp_path, name):
    package, _, cls = NAMES[name].rpartition(".")
    made = getattr(pytest.importorskip(package), cls)
    env = gym.make("CartPole-v1" if name == "dqn" else "Pendulum-v1")
    policy = "MlpLstmPolicy" if name == "recurrent_ppo" else "MlpPolicy"
    off = {"buffer_size": 10} if hasattr(made, "_store_transition") else {}
    made(policy, env, device="cpu", **off).save(tmp_path / "model.zip")
    expected = "td3" if name == "ddpg" else name  # the same as a policy
    assert read_note(tmp_path / "model.zip")["algo"] == expected


def test_what_nobody_made():
    assert made_by({"gamma": 0.9}) is None
    assert made_by({}) is None
