"""A policy with an end for the tests of `collect`: what it does to an episode is drawn."""

import numpy as np
import torch


class Planned:
    """Holds the pose, done after 6 steps or never; in a third of the episodes it moves."""

    def __init__(self):
        self.done, self.kind = np.zeros(0, bool), np.zeros(0, int)

    @property
    def failures(self):
        texts = {True: "step 2, grasp cube: the fingers closed on nothing", False: None}
        return [
            texts[bool(done and kind == 0)] for done, kind in zip(self.done, self.kind, strict=True)
        ]

    def reset(self, env_ids):
        if env_ids is None:
            self.fresh = None
        else:
            self.fresh[env_ids] = True

    def __call__(self, obs, env):
        if self.fresh is None:
            self.fresh = np.ones(env.num_envs, bool)
            self.kind, self.steps = np.zeros((2, env.num_envs), int)
            self.done = np.zeros(env.num_envs, bool)
        ids = np.flatnonzero(self.fresh)
        if len(ids):
            self.kind[ids] = env.streams.uniform("planned", (), 0, 3, ids).astype(int)
            self.steps[ids], self.fresh[ids] = 0, False
        self.steps += 1
        self.done = (self.steps >= 6) & (self.kind < 2)
        return torch.from_numpy(np.repeat(self.kind[:, None] == 0, 6, axis=1).astype(np.float32))
