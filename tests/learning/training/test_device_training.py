"""Trainings on arrays of a device, where every hidden copy to the host is an error.

The device is Warp's CPU: its arrays refuse what those of a GPU would wait for.
"""

import numpy as np
import pytest
import torch

from embodichain.config import make_env, resolve
from embodichain.learning import evaluate, load_policy
from embodichain.learning.checkpoints.plain_state import read_tree
from embodichain.learning.training.train import train

pytestmark = pytest.mark.slow

pytest.importorskip("mujoco_warp")

CART = (
    *("task=cart_pole", "task.max_episode_steps=7", "num_envs=4", "seed=1", "sim.engine=warp"),
    *("sim.warp.arrays=device", "sim.warp.nconmax=8", "sim.warp.njmax=16"),
)
ALGORITHMS = {
    "rsl_rl": ("algo=rsl_rl_ppo", "algo.num_steps_per_env=8", "algo.hidden_dims=[8]"),
    "skrl": ("algo=skrl_ppo", "algo.rollouts=8", "algo.hidden_dims=[8]"),
}


def config(*lines):
    return resolve([*CART, *lines], "train")


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_a_training_copies_nothing_and_goes_on_to_the_bit(tmp_path, algo):
    pytest.importorskip(algo)
    whole, first, second = (tmp_path / name for name in ("whole", "first", "second"))
    for folder in (whole, first, second):
        folder.mkdir()
    lines = ALGORITHMS[algo]
    summary = train(config(*lines, "total_timesteps=64"), whole)
    assert (summary.env_steps, summary.status) == (64, "finished") and summary.episodes >= 8
    train(config(*lines, "total_timesteps=32"), first)
    train(config(*lines, "total_timesteps=64", f"resume={first}"), second)
    states = [read_tree(p / "checkpoints/final.state.npz")["training"] for p in (whole, second)]
    (one, two), name = states, "policy"
    assert torch.equal(one["groups"][name], two["groups"][name])
    assert torch.equal(one["returns"], two["returns"])
    resolved = config(*lines)
    env = make_env(resolved)
    try:
        found = evaluate(env, load_policy(whole, env), episodes=4, seed=0)
        assert found.complete and 1 <= found.length.mean <= 7
    finally:
        env.close()


def test_stable_baselines3_learns_there_too(tmp_path):
    lines = ("algo=ppo", "algo.n_steps=8", "algo.batch_size=16", "algo.n_epochs=1")
    summary = train(config(*lines, "total_timesteps=32"), tmp_path)
    assert summary.env_steps == 32 and summary.episodes >= 4
    assert summary.mean_return is not None and np.isfinite(summary.mean_return)
