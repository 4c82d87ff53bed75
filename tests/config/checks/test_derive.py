"""What null keys become: suggested values, defaults; and what `algo` is made of."""

import pytest

from embodichain.config import resolve
from embodichain.utils.errors import ConfigError
from tests.config.conftest import WriteTask

TRAIN = """suggested:
  train:
    num_envs: 8
    total_timesteps: 1e6
    algo: {name: ppo, gamma: 0.9, n_steps: 32, policy_kwargs: {log_std_init: -1, net_arch: [8]}}
"""
SUGGESTED = "suggested:\n  run: {num_envs: 2, episodes: 3}\n"


def test_suggested_values_fill_nulls(write_task: WriteTask) -> None:
    write_task()
    root = resolve(["task=mine"]).root
    assert (root.num_envs, root.episodes) == (2, 3)
    root = resolve(["task=mine", "num_envs=5"]).root
    assert (root.num_envs, root.episodes) == (5, 3)


def test_defaults_without_suggestions(write_task: WriteTask) -> None:
    write_task(SUGGESTED, "")
    root = resolve(["task=mine"]).root
    assert (root.num_envs, root.episodes, root.max_steps) == (1, 1, None)
    assert (root.policy, root.device) == ("random", "cpu")


def test_run_ignores_what_is_suggested_for_training(write_task: WriteTask) -> None:
    write_task(SUGGESTED, TRAIN)
    assert resolve(["task=mine"]).root.num_envs == 1
    assert resolve(["task=mine"], "train").root.num_envs == 8


def test_a_seed_is_drawn_and_recorded(write_task: WriteTask) -> None:
    write_task()
    first, second = resolve(["task=mine"]), resolve(["task=mine"])
    assert first.root.seed != second.root.seed
    assert first.root.seed == first.tree["seed"] == first.env_cfg.seed
    assert resolve(["task=mine", "seed=3"]).root.seed == 3


def test_suggested_algorithm_under_the_users(write_task: WriteTask) -> None:
    write_task(SUGGESTED, TRAIN)
    lines = ["task=mine", "algo.gamma=0.5", "algo.policy_kwargs.log_std_init=0"]
    resolved = resolve(lines, "train")
    assert resolved.root.total_timesteps == 1_000_000
    assert type(resolved.tree["total_timesteps"]) is int
    assert resolved.root.algo is not None
    assert resolved.root.algo.arguments() == {
        "policy": "MlpPolicy",
        "gamma": 0.5,
        "n_steps": 32,
        "batch_size": 64,  # a quarter of the 8 x 32 steps
        "policy_kwargs": {"log_std_init": 0, "net_arch": [8]},
    }


def test_an_algorithm_without_suggestions(write_task: WriteTask) -> None:
    write_task()
    root = resolve(["task=mine", "total_timesteps=100", "algo.n_steps=4"], "train").root
    assert root.algo is not None
    given = {"policy": "MlpPolicy", "n_steps": 4, "policy_kwargs": {}}
    assert root.algo.arguments() == {**given, "batch_size": 2}
    assert resolve(["task=mine"]).root.algo is None


def test_an_unknown_suggested_algorithm(write_task: WriteTask) -> None:
    write_task(SUGGESTED, TRAIN.replace("ppo", "poo"))
    with pytest.raises(ConfigError) as error:
        resolve(["task=mine"], "train")
    assert str(error.value) == (
        "conf/task/mine.yaml:37: task.suggested.train.algo.name: unknown algorithm 'poo';"
        " one of: ppo, a2c, sac, td3, ddpg, dqn, trpo, tqc, crossq, recurrent_ppo, bc,"
        " rsl_rl_ppo, skrl_ppo. Did you mean 'ppo'?"
    )


def test_the_environment_gets_what_concerns_it(write_task: WriteTask) -> None:
    write_task()
    lines = ["task=mine", "num_envs=6", "seed=9", "sim.num_threads=2", "sim.persistent=false"]
    cfg = resolve(lines).env_cfg
    assert (cfg.num_envs, cfg.seed) == (6, 9)
    assert (cfg.sim_cfg.num_envs, cfg.sim_cfg.num_threads) == (6, 2)
    assert cfg.sim_cfg.persistent is False
    assert cfg.sim_cfg.headless
    assert not resolve(["task=mine", "viewer=native"]).env_cfg.sim_cfg.headless
