"""What the tests of learning share: one core for torch, and the task `reach` in small."""

import pytest
import torch

from embodichain.config import resolve
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import TerminationCfg


@pytest.fixture(autouse=True, scope="session")
def one_torch_thread():
    """Networks of a few neurons only lose with more threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def ends_early(env, obs, action, info):
    """Odd environments fail, environment i in its step 3 + i."""
    ids = torch.arange(env.num_envs)
    return (env.elapsed_steps == 3 + ids) & (ids % 2 == 1)


@pytest.fixture
def make_reach():
    """Builds `reach` with episodes of 6 steps; odd environments fail before (see `ends_early`)."""
    built = []

    def make(num_envs, mode="SAME_STEP", early=True, **options):
        overrides = ["task=reach", "task.max_episode_steps=6", "seed=3", f"num_envs={num_envs}"]
        cfg = resolve(overrides, "train").env_cfg
        if early:
            cfg.terminations["early"] = TerminationCfg(func=ends_early, kind="fail")
        built.append(BaseEnv(cfg, autoreset_mode=mode, **options))
        return built[-1]

    yield make
    for env in built:
        env.close()
