"""Task classes as EmbodiChain's are written, for its two learned tasks: what success is, in Python.

`upstream_cart_pole.json` and `upstream_push_cube.json` beside this file hold the fields and values
of EmbodiChain 0.2.1's own configs.
"""

from pathlib import Path

import torch

from embodichain.lab.gym.envs import EmbodiedEnv, EmbodiedEnvCfg
from embodichain.lab.gym.utils.registration import register_env

CONFIGS = Path(__file__).with_name("gym_configs")


@register_env("CartPoleRL", max_episode_steps=50, override=True)
class CartPole(EmbodiedEnv):
    """An upright pole at the end of the episode is a success; it is cut off when it has fallen."""

    def __init__(self, cfg=None, **kwargs):
        super().__init__(EmbodiedEnvCfg() if cfg is None else cfg, **kwargs)

    def get_reward(self, obs, action, info):
        """1 for an upright pole, 0 for a hanging one."""
        return 1.0 - self.robot.get_qpos(name="hand").reshape(-1).abs() / torch.pi

    def compute_task_state(self, **kwargs):
        """Success in the last step, no failure, and the angle."""
        angle = self.robot.get_qpos(name="hand").reshape(-1).abs()
        speed = self.robot.get_qvel(name="hand").reshape(-1).abs()
        last = self._elapsed_steps >= self.max_episode_steps - 1
        nobody = torch.zeros(self.num_envs, device=self.device, dtype=torch.bool)
        return last & (angle < 0.02) & (speed < 0.05), nobody, {"distance_to_goal": angle}

    def check_truncated(self, obs, info):
        """Beyond a right angle."""
        return self.robot.get_qpos(name="hand").reshape(-1).abs() > torch.pi * 0.5


@register_env("PushCubeRL", max_episode_steps=50, override=True)
class PushCube(EmbodiedEnv):
    """A cube near its goal is a success; it is cut off when it has left the table."""

    def __init__(self, cfg=None, **kwargs):
        super().__init__(EmbodiedEnvCfg() if cfg is None else cfg, **kwargs)

    def compute_task_state(self, **kwargs):
        """Success within `success_threshold` in the plane, no failure, and the distance."""
        place = self.sim.get_rigid_object("cube").get_local_pose(to_matrix=True)[:, :3, 3]
        nobody = torch.zeros(self.num_envs, device=self.device, dtype=torch.bool)
        goal = getattr(self, "goal_pose", None)
        if goal is None:
            return nobody, nobody.clone(), {"distance_to_goal": torch.zeros(self.num_envs)}
        far = torch.norm(place[:, :2] - goal[:, :2, 3], dim=1)
        return far < self.success_threshold, nobody, {"distance_to_goal": far}

    def check_truncated(self, obs, info):
        """Below the ground."""
        cube = self.sim.get_rigid_object("cube").get_local_pose(to_matrix=True)
        return cube[:, 2, 3] < -0.1
