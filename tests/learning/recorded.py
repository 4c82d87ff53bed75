"""Episodes recorded from a batched environment, as demonstrations."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch


@dataclass
class Recorded:
    observations: dict[str, Any]
    actions: np.ndarray
    rewards: np.ndarray
    terminated: bool = False


def record(env, policy, steps):
    """One episode of so many steps of each environment; `policy` maps named observations."""
    names = env.observation_manager.group_terms("policy")

    def seen(obs):
        return {name: obs[tuple(name.split("/"))].numpy().copy() for name in names}

    obs, _ = env.reset()
    rows, actions, rewards = [seen(obs)], [], []
    for _ in range(steps):
        actions.append(policy(rows[-1]).astype(np.float32))
        obs, reward, terminated, _, info = env.step(torch.from_numpy(actions[-1]))
        assert not terminated.any()
        rewards.append(reward.numpy().copy())
        rows.append(seen(info.get("final_obs", obs)))
    return [
        Recorded(
            {name: np.stack([row[name][i] for row in rows]) for name in names},
            np.stack([a[i] for a in actions]),
            np.stack([r[i] for r in rewards]),
        )
        for i in range(env.num_envs)
    ]
