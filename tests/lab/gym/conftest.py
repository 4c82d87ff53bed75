"""Small environments: a UR10 and a kinematic marker that jumps at random, with what a test adds."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import EnvCfg, EventCfg, ObservationCfg
from embodichain.lab.sim.cfg import (
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.shapes import CubeCfg

HOME = [1.57079, -1.57079, 1.57079, -1.57079, -1.57079, -3.14159]
UR10 = "UniversalRobots/UR10/UR10.urdf"


def jump(env: Any, env_ids: Any) -> None:
    """An event that draws: the marker goes somewhere else."""
    env.sim.get_rigid_object("cube").set_local_pose(
        torch.cat([env.rand("jump", (3,), -1, 1, env_ids), _up(env, env_ids)], dim=1), env_ids
    )


def _up(env: Any, env_ids: Any) -> torch.Tensor:
    count = env.num_envs if env_ids is None else len(env_ids)
    return torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1)


def noise(env: Any, obs: Any) -> torch.Tensor:
    """An observation that draws."""
    return env.rand("noise", (2,))


def marker(env: Any, obs: Any) -> torch.Tensor:
    """(N, 3) where the marker is."""
    return env.sim.get_rigid_object("cube").get_local_pose()[:, :3].contiguous()


def jumping() -> dict[str, Any]:
    """Events and observations that draw random numbers in every step and reset."""
    return {
        "events": {
            "move": EventCfg(func=jump, mode="interval", interval_step=1),
            "place": EventCfg(func=jump, mode="reset"),
        },
        "observations": {
            "cube": ObservationCfg(func=marker),
            "noise": ObservationCfg(func=noise),
        },
    }


def task(**sections: Any) -> EnvCfg:
    """The scene of the tests; sections are those of `EnvCfg`."""
    base: dict[str, Any] = {
        "num_envs": 3,
        "sim_cfg": SimulationManagerCfg(headless=True, num_threads=1),
        "robot": RobotCfg(uid="ur10", fpath=UR10, init_pos=(0.0, 0.0, 1.0), init_qpos=HOME),
        "objects": {
            "cube": RigidObjectCfg(
                shape=CubeCfg(size=[0.03, 0.03, 0.03]),
                body_type="kinematic",
                attrs=RigidBodyAttributesCfg(enable_collision=False),
                init_pos=(0.0, 0.0, 0.5),
            )
        },
    }
    return EnvCfg(**{**base, **sections})


def home(env: Any) -> torch.Tensor:
    """(N, 6) the action that holds the arm where it starts."""
    return torch.tensor([HOME]).repeat(env.num_envs, 1)


def targets(env: Any, step: int) -> torch.Tensor:
    """(N, 6) a deterministic action that moves the arm; row i is the same for every N."""
    phase = 0.3 * step + torch.arange(env.num_envs)[:, None] + 0.1 * torch.arange(6)
    return home(env) + 0.2 * torch.sin(phase)


def flat(obs: Any) -> np.ndarray:
    """(N, W) every number of an observation."""
    leaves = [leaf.reshape(leaf.shape[0], -1) for _, leaf in obs.items(True, True)]
    return torch.cat([leaf.to(torch.float64) for leaf in leaves], dim=1).numpy()


@pytest.fixture
def make_env() -> Iterator[Callable[..., Any]]:
    """Builds environments (sections of the task, or a config), and closes them after the test."""
    from embodichain.lab.gym.envs.base_env import BaseEnv

    built = []

    def build(cfg: EnvCfg | None = None, cls: type = BaseEnv, env_kwargs: Any = None, **kw: Any):
        env = cls(task(**kw) if cfg is None else cfg, **(env_kwargs or {}))
        built.append(env)
        return env

    yield build
    for env in built:
        env.close()
