"""Built-in action terms: joint positions, absolute, around the initial ones, and relative."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.action_manager import ActionTerm
from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.utils.bounds import joint_bounds
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.base import F64
else:
    torch = lazy_loader.load("torch")

__all__ = ["DefaultOffsetJointPosition", "JointPosition", "RelativeJointPosition"]


class _JointPositionTerm(ActionTerm):
    """What the three have in common: the joints, and writing drive targets.

    The drives clamp targets to the joints' limits.
    """

    def __init__(self, entity: ResolvedEntity) -> None:
        asset = entity.asset
        if not hasattr(asset, "parsed"):
            raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} has no joints")])
        if not entity.joint_ids:
            raise ConfigError([Problem("entity_cfg", f"{entity.uid!r} has no active joint")])
        actuators = np.asarray(asset.entity.actuator_ids)[list(entity.joint_ids)]
        undriven = [n for n, a in zip(entity.joint_names, actuators, strict=True) if a < 0]
        if undriven:
            message = f"joints {undriven} have no drive (drive_type none, or they mimic another)"
            raise ConfigError([Problem("entity_cfg", message)])
        self.names = entity.joint_names
        self._asset = asset
        self._ids: NDArray[np.int64] = np.asarray(entity.joint_ids, np.int64)
        self._joints = None if entity.all_joints else self._ids
        self._default: F64 = np.asarray(asset.parsed.init_qpos, np.float64)[self._ids]

    def _write(self, target: Any) -> None:
        self._asset.write_target(target, self._joints)

    def _targets(self) -> F64:
        """(N, A) current drive targets."""
        targets: F64 = self._asset.drives.read_target_qpos()[:, self._ids]
        return targets


@register_term("action", name="joint_position")
class JointPosition(_JointPositionTerm):
    """Absolute joint position targets: target = action.

    The bounds are the joints' limits (for a joint without limits, +-2 pi). Isaac Lab's
    JointPositionAction without scale and offset; EmbodiChain's QposTerm.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
    """

    def __init__(self, env: BaseEnv, entity_cfg: ResolvedEntity) -> None:
        super().__init__(entity_cfg)
        low, high = joint_bounds(self._asset.parsed.qpos_limits, self._ids)
        self.low: NDArray[np.float32] = low
        self.high: NDArray[np.float32] = high

    def apply(self, action: torch.Tensor) -> None:
        """Write (N, A) rad or m as the drives' targets."""
        self._write(action.numpy())

    def home(self) -> F64:
        """(A,) the action that goes to the initial position."""
        return self._default

    def hold(self) -> F64:
        """(N, A) the action that keeps the present targets."""
        return self._targets()


@register_term("action", name="default_offset_joint_position")
class DefaultOffsetJointPosition(_JointPositionTerm):
    """Joint position targets around the initial position.

    target = init_qpos + offset + scale x clamp(action, clip), computed in float64; the bounds are
    `clip`. EmbodiChain 0.3's joint_position.default_offset contract.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        scale: rad or m per unit of action; one value, or one a joint.
        clip: [low, high] of the action.
        offset: rad or m; one value, or one a joint.
    """

    def __init__(
        self,
        env: BaseEnv,
        entity_cfg: ResolvedEntity,
        scale: float | list[float] = 1.0,
        clip: Range = (-1.0, 1.0),
        offset: float | list[float] = 0.0,
    ) -> None:
        super().__init__(entity_cfg)
        count = len(self._ids)
        self._scale = _values(scale, count, "scale")
        if (self._scale == 0).any():
            raise ConfigError([Problem("scale", "must not be 0")])
        self._centre: F64 = self._default + _values(offset, count, "offset")
        self._clip = (float(clip[0]), float(clip[1]))
        self.low: NDArray[np.float32] = np.full(count, clip[0], np.float32)
        self.high: NDArray[np.float32] = np.full(count, clip[1], np.float32)

    def apply(self, action: torch.Tensor) -> None:
        """Write targets for (N, A) actions."""
        low, high = self._clip
        clamped = np.minimum(np.maximum(action.numpy(), low), high)
        self._write(self._centre + self._scale * clamped)

    def home(self) -> F64:
        """(A,) the action that goes to the initial position, as far as `clip` allows."""
        found: F64 = np.clip((self._default - self._centre) / self._scale, *self._clip)
        return found

    def hold(self) -> F64:
        """(N, A) the action that keeps the present targets, as far as `clip` allows."""
        found: F64 = np.clip((self._targets() - self._centre) / self._scale, *self._clip)
        return found


@register_term("action", name="relative_joint_position")
class RelativeJointPosition(_JointPositionTerm):
    """Joint position targets relative to where the joints are now.

    target = qpos + scale x clamp(action, clip), once a control step. EmbodiChain's DeltaQposTerm,
    which works on any choice of joints here.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        scale: rad or m per unit of action; one value, or one a joint.
        clip: [low, high] of the action.
    """

    def __init__(
        self,
        env: BaseEnv,
        entity_cfg: ResolvedEntity,
        scale: float | list[float] = 1.0,
        clip: Range = (-1.0, 1.0),
    ) -> None:
        super().__init__(entity_cfg)
        count = len(self._ids)
        self._scale = _values(scale, count, "scale")
        self._clip = (float(clip[0]), float(clip[1]))
        self.low: NDArray[np.float32] = np.full(count, clip[0], np.float32)
        self.high: NDArray[np.float32] = np.full(count, clip[1], np.float32)

    def apply(self, action: torch.Tensor) -> None:
        """Write targets for (N, A) actions."""
        low, high = self._clip
        clamped = np.minimum(np.maximum(action.numpy(), low), high)
        self._write(self._asset.read_qpos()[:, self._ids] + self._scale * clamped)


def _values(value: float | list[float], count: int, name: str) -> F64:
    """(count,) float64 of one value or one a joint."""
    array = np.asarray(value, np.float64)
    if array.ndim and array.shape != (count,):
        message = f"needs one value or {count}, one a joint; got {array.shape[0]}"
        raise ConfigError([Problem(name, message)])
    if not np.isfinite(array).all():
        raise ConfigError([Problem(name, f"must be finite, got {value}")])
    return np.broadcast_to(array, (count,)).copy()
