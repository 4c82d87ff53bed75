"""Values of reward-like terms without a step, and where the cube of the test scene is put."""

from typing import Any

import numpy as np
import torch

from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg, TerminationCfg
from embodichain.lab.gym.envs.managers import MetricManager, RewardManager, TerminationManager


def reward(env: Any, func: str, **params: Any) -> list[float]:
    """A reward's value now, (N,)."""
    manager = RewardManager(env, {"it": RewardCfg(func=func, params=params)})
    info: dict[str, Any] = {}
    manager.compute(torch.zeros(env.num_envs), None, None, info)
    return info["rewards"]["it"].tolist()


def ends(env: Any, func: str, **params: Any) -> list[bool]:
    """A termination's value now, (N,)."""
    manager = TerminationManager(env, {"it": TerminationCfg(func=func, params=params)})
    return manager.compute(None, None, {})["fail"].tolist()


def holds(env: Any, func: str, **params: Any) -> list[bool]:
    """A predicate's value now, (N,); the same as a reward, a metric and a termination."""
    manager = MetricManager(env, {"it": MetricCfg(func=func, params=params, reduce="any")})
    info: dict[str, Any] = {}
    manager.compute(None, None, info)
    found = info["metrics"]["it"].tolist()
    assert reward(env, func, **params) == [float(value) for value in found]
    assert ends(env, func, **params) == found
    return found


def turned(axis: Any, angle: float) -> list[float]:
    """Wxyz quaternion of a rotation by an angle in radians about an axis of length 1."""
    return [float(np.cos(angle / 2)), *(np.sin(angle / 2) * np.asarray(axis, float))]


def put(env: Any, uid: str, pos: Any, quat: Any = (1, 0, 0, 0)) -> None:
    """Put an object somewhere, the same or a row for each environment."""
    pos = np.broadcast_to(np.asarray(pos, float), (env.num_envs, 3))
    quat = np.broadcast_to(np.asarray(quat, float), (env.num_envs, 4))
    env.sim.get_asset(uid).set_local_pose(np.concatenate([pos, quat], axis=1))


def move(env: Any, uid: str, linear: Any = (0, 0, 0), angular: Any = (0, 0, 0)) -> None:
    """Give a dynamic object a velocity in world axes."""
    rows = [np.broadcast_to(np.asarray(v, float), (env.num_envs, 3)) for v in (linear, angular)]
    env.sim.get_asset(uid).set_velocity(*rows)


def bend(env: Any, qpos: Any, qvel: Any = 0.0) -> None:
    """Teleport the arm's six joints, and give them velocities."""
    shape = (env.num_envs, 6)
    env.robot.set_qpos(np.broadcast_to(np.asarray(qpos, float), shape), target=False)
    env.robot.set_qvel(np.broadcast_to(np.asarray(qvel, float), shape), target=False)
