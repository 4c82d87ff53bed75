"""A UR10 beside a table on which a cube lies: a task in EmbodiChain's form, without own code.

Objects and lights are lists of configs, events and observations configclasses of functors. Run it
with `python scripts/tutorials/gym/modular_env.py --headless --num_envs 4`.
"""

from __future__ import annotations

import argparse

import gymnasium as gym
import torch

import embodichain.lab.gym.envs.managers.observations as obs
import embodichain.lab.gym.envs.managers.randomization as rand
from embodichain.lab.gym.envs import EmbodiedEnv, EmbodiedEnvCfg
from embodichain.lab.gym.envs.managers import EventCfg, ObservationCfg, SceneEntityCfg
from embodichain.lab.gym.utils.gym_utils import add_env_launcher_args_to_parser
from embodichain.lab.gym.utils.registration import register_env
from embodichain.lab.sim import SimulationManagerCfg
from embodichain.lab.sim.cfg import (
    LightCfg,
    RenderCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
)
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.utils import configclass

ENV_ID = "ModularTutorial-v0"


@configclass
class Events:
    """What is random: the cube's mass at every reset, the light every five steps."""

    cube_mass: EventCfg = EventCfg(
        func=rand.randomize_rigid_object_mass,
        mode="reset",
        params={"entity_cfg": SceneEntityCfg(uid="cube"), "mass_range": (0.1, 2.0)},
    )
    lamp: EventCfg = EventCfg(
        func=rand.randomize_light,
        mode="interval",
        interval_step=5,
        params={
            "entity_cfg": SceneEntityCfg(uid="lamp"),
            "position_range": [[-0.5, -0.5, 2.0], [0.5, 0.5, 2.0]],
            "color_range": [[0.6, 0.6, 0.6], [1.0, 1.0, 1.0]],
            "intensity_range": [10.0, 30.0],
        },
    )


@configclass
class Observations:
    """What is observed besides the robot's joints."""

    cube_pose: ObservationCfg = ObservationCfg(
        func=obs.get_rigid_object_pose,
        mode="add",
        name="cube/pose",
        params={"entity_cfg": SceneEntityCfg(uid="cube")},
    )


@configclass
class ModularCfg(EmbodiedEnvCfg):
    """The task."""

    robot: RobotCfg = RobotCfg(
        uid="arm",
        fpath="UniversalRobots/UR10/UR10.urdf",
        init_qpos=[0.0, -1.57, 1.57, -1.57, -1.57, 0.0],
    )
    light: EmbodiedEnvCfg.EnvLightCfg = EmbodiedEnvCfg.EnvLightCfg(
        direct=[LightCfg(uid="lamp", light_type="point", intensity=20.0, init_pos=(0, 0, 2))]
    )
    background: list[RigidObjectCfg] = [
        RigidObjectCfg(
            uid="table",
            shape=CubeCfg(size=[0.6, 0.6, 0.4]),
            attrs=RigidBodyAttributesCfg(dynamic_friction=0.85),
            body_type="kinematic",
            init_pos=(0.9, 0.0, 0.2),
        )
    ]
    rigid_object: list[RigidObjectCfg] = [
        RigidObjectCfg(uid="cube", shape=CubeCfg(size=[0.06] * 3), init_pos=(0.9, 0.0, 0.43))
    ]
    events = Events()
    observations = Observations()


@register_env(ENV_ID, max_episode_steps=100, override=True)
class ModularEnv(EmbodiedEnv):
    """The task as an environment: the config says everything."""


def main() -> None:
    """Play two episodes of one action."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_env_launcher_args_to_parser(parser)
    args = parser.parse_args()
    cfg = ModularCfg(
        num_envs=args.num_envs,
        sim_cfg=SimulationManagerCfg(
            render_cfg=RenderCfg(renderer=args.renderer),
            headless=args.headless,
            sim_device=args.device,
        ),
    )
    env = gym.make(ENV_ID, cfg=cfg)
    action = torch.as_tensor(env.unwrapped.robot.cfg.init_qpos).expand(env.action_space.shape)
    for _ in range(2):
        env.reset()
        for _ in range(100):
            observed, *_, info = env.step(action)
        print(f"cube at {observed['cube']['pose'][0, :3, 3].tolist()}")
    env.close()


if __name__ == "__main__":
    main()
