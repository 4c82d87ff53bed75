"""A UR10 that jitters around its home pose while a marker cube jumps about, as a Python class.

The same task without Python is conf/task/random_reach.yaml. Run it with
`python scripts/tutorials/gym/random_reach.py --headless --num_envs 4`.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from embodichain.data import get_data_path
from embodichain.lab.gym.envs import BaseEnv, EnvCfg
from embodichain.lab.gym.utils.gym_utils import add_env_launcher_args_to_parser
from embodichain.lab.gym.utils.registration import register_env
from embodichain.lab.sim import SimulationManagerCfg
from embodichain.lab.sim.cfg import RenderCfg, RigidBodyAttributesCfg, RigidObjectCfg, RobotCfg
from embodichain.lab.sim.objects import Robot
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.lab.sim.types import EnvAction

ENV_ID = "RandomReachTutorial-v0"


@register_env(ENV_ID, override=True)
class RandomReachEnv(BaseEnv):
    """N arms, each with a cube that is only looked at.

    Args:
        num_envs: N.
        headless: Whether no window opens.
        device: Where physics runs.
        renderer: Accepted by name; pictures are MuJoCo's.
        **kwargs: For `BaseEnv`.
    """

    home = np.array([1.57079, -1.57079, 1.57079, -1.57079, -1.57079, -3.14159])

    def __init__(
        self,
        num_envs: int = 1,
        headless: bool = False,
        device: str = "cpu",
        renderer: Any = "hybrid",
        **kwargs: Any,
    ) -> None:
        sim_cfg = SimulationManagerCfg(
            headless=headless,
            arena_space=2.0,
            sim_device=device,
            render_cfg=RenderCfg(renderer=renderer),
        )
        super().__init__(cfg=EnvCfg(num_envs=num_envs, sim_cfg=sim_cfg), **kwargs)

    def _setup_robot(self, **kwargs: Any) -> Robot:
        robot = self.sim.add_robot(
            RobotCfg(
                uid="ur10",
                fpath=get_data_path("UniversalRobots/UR10/UR10.urdf"),
                init_pos=(0.0, 0.0, 1.0),
                init_qpos=self.home,
            )
        )
        low, high = robot.body_data.qpos_limits[0].unbind(dim=1)
        self.single_action_space = gym.spaces.Box(low.numpy(), high.numpy(), dtype=np.float32)
        return robot

    def _prepare_scene(self, **kwargs: Any) -> None:
        self.cube = self.sim.add_rigid_object(
            RigidObjectCfg(
                uid="cube",
                shape=CubeCfg(size=[0.03, 0.03, 0.03]),
                attrs=RigidBodyAttributesCfg(enable_collision=False),
                body_type="kinematic",
                init_pos=(0.0, 0.0, 0.5),
            )
        )

    def _step_action(self, action: EnvAction) -> EnvAction:
        self.robot.set_qpos(action)
        return action

    def _update_sim_state(self, **kwargs: Any) -> None:
        pose = torch.zeros(self.num_envs, 7)
        pose[:, 3] = 1.0  # w of the unit quaternion
        pose[:, :3] = self.rand("cube", (3,), -0.25, 0.25)
        self.cube.set_local_pose(pose)


def main() -> None:
    """Run ten episodes of random targets around the home pose and print the speed."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    add_env_launcher_args_to_parser(parser)
    args = parser.parse_args()
    env = gym.make(
        ENV_ID,
        num_envs=args.num_envs,
        headless=args.headless,
        device=args.device,
        renderer=args.renderer,
    )
    task: RandomReachEnv = env.unwrapped  # type: ignore[assignment]
    home = torch.from_numpy(task.home)
    try:
        for episode in range(10):
            env.reset()
            start = time.perf_counter()
            for _ in range(100):
                env.step(home + task.rand("policy", (len(home),), -0.1, 0.1))
            seconds = time.perf_counter() - start
            steps = 100 * task.num_envs
            print(
                f"Episode {episode}: {steps} steps in {seconds:.2f} s, FPS: {steps / seconds:.0f}"
            )
    finally:
        env.close()


if __name__ == "__main__":
    main()
