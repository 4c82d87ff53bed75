"""A scene for tests of terms: one UR10, a free cube on the floor, a kinematic goal.

Each friction of cube and ground is larger than another one that it meets, and so can act.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.sim.cfg import (
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.configs.contact_cfg import ContactCfg
from embodichain.lab.sim.configs.scene_cfg import GroundCfg, SceneCfg
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg

HOME = [1.57079, -1.57079, 1.57079, -1.57079, -1.57079, -3.14159]
UR10 = "UniversalRobots/UR10/UR10.urdf"
CUBE_POS = (0.5, 0.5, 0.05)
GOAL_POS = (0.5, 0.2, 0.5)


def task(**sections: Any) -> EnvCfg:
    """The scene with three environments; sections are those of `EnvCfg`."""
    base: dict[str, Any] = {
        "num_envs": 3,
        "seed": 7,
        "sim_cfg": SimulationManagerCfg(headless=True, num_threads=1),
        "scene": SceneCfg(ground=GroundCfg(friction=[0.3, 0.01, 0.0001])),
        "robot": RobotCfg(
            uid="ur10",
            fpath=UR10,
            attrs=RigidBodyAttributesCfg(dynamic_friction=0.1),
            init_pos=(0.0, 0.0, 1.0),
            init_qpos=HOME,
        ),
        "objects": {
            "cube": RigidObjectCfg(
                shape=CubeCfg(size=[0.1, 0.1, 0.1]),
                init_pos=CUBE_POS,
                init_rot=(0, 0, 90),
                contact=ContactCfg(friction=[0.5, 0.005, 0.0003], condim=6),
            ),
            "goal": RigidObjectCfg(
                shape=SphereCfg(radius=0.02),
                body_type="kinematic",
                attrs=RigidBodyAttributesCfg(enable_collision=False),
                init_pos=GOAL_POS,
            ),
        },
        "max_episode_steps": 50,
    }
    return EnvCfg(**{**base, **sections})


@contextmanager
def builder() -> Iterator[Any]:
    """A function that builds environments of the scene; they are closed at the end."""
    from embodichain.lab.gym.envs.base_env import BaseEnv

    built = []

    def build(**sections: Any) -> BaseEnv:
        env = BaseEnv(task(**sections))
        built.append(env)
        return env

    yield build
    for env in built:
        env.close()
