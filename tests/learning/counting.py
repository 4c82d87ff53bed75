"""A batched environment whose every number can be told in advance: it counts."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode

from embodichain.utils.arrays import Arrays
from embodichain.utils.tensor_mapping import TensorMapping


class CountingEnv(gym.Env):
    """Observes (environment, episode, steps); the reward is the sum of the action.

    Environment i terminates after ``ends[i]`` steps (0: never), which is a success if i is even,
    and is truncated after `limit`. Rewards are one buffer, overwritten in every step: who does
    not copy them is found out.
    """

    def __init__(self, ends, limit=10, low=-1.0, high=1.0, has_success=True, mode="SAME_STEP"):
        self.num_envs = len(ends)
        self.device, self.arrays = torch.device("cpu"), Arrays()
        self.render_mode = None
        self.is_closed = False
        self.metadata = {"autoreset_mode": AutoresetMode[mode]}
        self.ends = np.asarray(ends)
        self.limit = self.max_episode_steps = limit
        self.single_action_space = gym.spaces.Box(low, high, (2,), np.float32)
        box = gym.spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.single_observation_space = gym.spaces.Dict(
            {
                "where": gym.spaces.Dict({"id": gym.spaces.Box(-np.inf, np.inf, (1,))}),
                "time": box,
                "other": box,
            }
        )
        self.observation_manager = SimpleNamespace(
            group_terms=self._group_terms,
            image_terms=lambda group: (),
            flat_rows=lambda obs, group: np.concatenate([obs["where", "id"], obs["time"]], axis=1),
            flatten=lambda obs, group: torch.cat([obs["where", "id"], obs["time"]], dim=1),
        )
        self.judges_success = has_success
        self.curriculum_manager = SimpleNamespace(values={})
        self.cfg = SimpleNamespace(counts=True, curriculum={})
        self.termination_manager = SimpleNamespace(values={})
        self.weights = np.arange(float(self.num_envs))
        self.level = 3
        self.resets = []
        self.actions = []
        self.count = np.zeros(self.num_envs, np.float32)
        self.episode = np.zeros(self.num_envs, np.float32)
        self._reward = torch.zeros(self.num_envs)

    @staticmethod
    def _group_terms(group):
        if group != "policy":
            raise ValueError(f"no observation is in group {group!r}; there are: policy.")
        return ("where/id", "time")

    def _obs(self):
        ids = torch.arange(self.num_envs, dtype=torch.float32)[:, None]
        time = torch.from_numpy(np.stack([self.episode, self.count], axis=1))
        where = TensorMapping({"id": ids})
        return TensorMapping({"where": where, "time": time})

    def reset(self, *, seed=None, options=None):
        self.resets.append((seed, options))
        self.count[:] = 0
        return self._obs(), {}

    def step(self, action):
        self.actions.append(action)
        self._reward[:] = action.sum(dim=1)
        self.count += 1
        terminated = self.count == self.ends
        truncated = self.count >= self.limit
        success = torch.from_numpy(terminated & (np.arange(self.num_envs) % 2 == 0))
        info = {"success": success, "success_terminated": success, "metrics": {}}
        info["fail"] = torch.from_numpy(terminated) & ~success
        info["diverged"] = torch.zeros(self.num_envs, dtype=torch.bool)
        info["elapsed_steps"] = torch.from_numpy(self.count.astype(np.int32))
        info["rewards"] = {"steps": torch.ones(self.num_envs)}
        info["episode_sums"] = {"steps": torch.from_numpy(self.count.copy())}
        obs = self._obs()
        done = terminated | truncated
        if done.any():
            info["final_info"] = dict(info)
            info["final_obs"] = obs
            self.episode[done] += 1
            self.count[done] = 0
            obs = self._obs()
        return obs, self._reward, torch.from_numpy(terminated), torch.from_numpy(truncated), info

    def double(self, value, env_ids=None):
        ids = np.arange(self.num_envs) if env_ids is None else env_ids
        return 2 * value * (1 + ids)

    def touch_all(self):
        return "touched"
