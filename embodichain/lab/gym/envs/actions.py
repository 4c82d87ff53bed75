"""Actions as `BaseEnv.step` accepts them, and what a robot without action terms does with one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.mdp.actions.joint_action import finite_limits
from embodichain.lab.sim.objects._arrays import all_finite
from embodichain.utils.tensor_mapping import leaves_of

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.action_manager import ActionManager
    from embodichain.lab.sim.engine.api import F64
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.lab.sim.types import EnvAction

__all__ = ["ActionCheck", "action_space", "drive_robot"]


def action_space(
    robot: Robot | None, joint_ids: Sequence[int], manager: ActionManager
) -> gym.spaces.Box:
    """Return the action space of one environment: that of action terms, or joint positions.

    The latter are finite for joints without limits too.
    """
    if len(manager):
        return gym.spaces.Box(manager.low, manager.high, dtype=np.float32)
    if robot is None:
        return gym.spaces.Box(0.0, 0.0, (0,), np.float32)
    low, high = finite_limits(robot.parsed.qpos_limits, joint_ids)
    return gym.spaces.Box(low.astype(np.float32), high.astype(np.float32))


class ActionCheck:
    """Checks actions against a space, before anything is written.

    Args:
        space: Action space of one environment; shapes are checked if it is a Box.
        num_envs: N.
        device: Where actions must be.
    """

    def __init__(self, space: gym.Space[Any], num_envs: int, device: torch.device) -> None:
        self._shape = (
            (num_envs, *(space.shape or ())) if isinstance(space, gym.spaces.Box) else None
        )
        self._num_envs = num_envs
        self._device = device

    def __call__(self, action: Any) -> tuple[EnvAction, F64]:
        """Check an action.

        Args:
            action: (N, A) floating tensor on the device, or a numpy array (converted to a float32
                tensor), or a mapping of such tensors (such as a TensorDict).

        Returns:
            The action, and its numbers as (N, A) float64 that share no memory with it.

        Raises:
            TypeError: If it is no floating tensor, array or mapping.
            ValueError: If its shape or device is wrong or a number is not finite.
        """
        if isinstance(action, np.ndarray):
            numbers = action
            tensor = (
                torch.from_numpy(action.astype(np.float32)) if action.dtype.kind == "f" else None
            )
        elif isinstance(action, torch.Tensor):
            if action.device != self._device:
                found = f"action is on {action.device}"
                raise ValueError(f"{found}; this environment is on {self._device}")
            tensor = action.detach() if action.requires_grad else action
            numbers = tensor.numpy()
        elif isinstance(action, Mapping):
            return action, self._finite(self._joined(action))
        else:
            raise TypeError(f"an action is a tensor {self._wanted()}, got {type(action).__name__}")
        if tensor is None or numbers.dtype.kind != "f":
            raise TypeError(
                f"an action is a floating point tensor {self._wanted()}, got {action.dtype}"
            )
        shape = numbers.shape
        if shape != self._shape and (self._shape is not None or shape[:1] != (self._num_envs,)):
            raise ValueError(f"action must have shape {self._wanted()}, got {shape}")
        given = numbers.astype(np.float64)
        return tensor, self._finite(given if given.ndim == 2 else given.reshape(len(given), -1))

    def _wanted(self) -> str:
        return f"({self._num_envs}, ...)" if self._shape is None else f"{self._shape}"

    def _joined(self, action: Mapping[str, Any]) -> F64:
        leaves = [leaf.detach().cpu().numpy() for _, leaf in leaves_of(action)]
        if not leaves:
            raise ValueError("the action is an empty mapping")
        for leaf in leaves:
            if leaf.shape[:1] != (self._num_envs,):
                raise ValueError(
                    f"action must have batch size ({self._num_envs},), got {leaf.shape[:1]}"
                )
        rows: list[NDArray[Any]] = [leaf.reshape(self._num_envs, -1) for leaf in leaves]
        return np.concatenate(rows, axis=1).astype(np.float64)

    @staticmethod
    def _finite(values: F64) -> F64:
        if not all_finite(values):
            rows = np.flatnonzero(~np.isfinite(values).all(axis=1))
            raise ValueError(f"action is not finite in environments {rows[:8].tolist()}")
        return values


def drive_robot(
    robot: Robot | None, joint_ids: list[int], action: EnvAction, seconds: float
) -> None:
    """Give a robot absolute joint targets.

    Args:
        robot: The robot; None does nothing.
        joint_ids: The A joints that are acted on.
        action: (N, A) position targets, clamped to the joints' limits and to what `max_velocity`
            of the drives allows, or a mapping with any of
            ``qpos``, ``qvel`` (velocity targets) and ``qf`` (efforts), each (N, A).
        seconds: The period of a control step.

    Raises:
        ValueError: If a shape or a key is wrong.
    """
    if robot is None:
        return
    joints = np.asarray(joint_ids, np.int64)
    drives = robot.drives

    def move(target: torch.Tensor, joint_ids: list[int]) -> None:
        wanted = np.asarray(target, np.float64)
        robot.set_qpos(drives.within_rate(wanted, joints, seconds), joint_ids=joint_ids)

    def turn(target: torch.Tensor, joint_ids: list[int]) -> None:
        most = drives.max_velocity[:, joints]
        robot.set_qvel(np.clip(np.asarray(target, np.float64), -most, most), joint_ids=joint_ids)

    if isinstance(action, torch.Tensor):
        move(action, joint_ids)
        return
    setters: dict[Any, Any] = {"qpos": move, "qvel": turn, "qf": robot.set_qf}
    unknown = [key for key in action.keys() if key not in setters]  # noqa: SIM118  (it may be a TensorDict)
    if unknown:
        raise ValueError(f"unknown action entries {unknown}; allowed: {', '.join(setters)}")
    for key, value in action.items():
        setters[key](value, joint_ids=joint_ids)
