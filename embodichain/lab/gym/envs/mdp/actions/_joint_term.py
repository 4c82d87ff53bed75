"""What joint actions have in common: the joints, and value = centre + scale x clamp(action).

What is done with the value is each term's own business.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.action_manager import ActionTerm
from embodichain.lab.gym.envs.mdp.actions._per_joint import joint_clip, per_joint
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.engine.base import F64

__all__ = ["AffineJointTerm", "JointTerm"]


class JointTerm(ActionTerm):
    """An action term of the picked joints.

    Args:
        env: The environment.
        entity: The robot and the joints picked.
        driven: Whether every joint must have a drive.

    Raises:
        ConfigError: If there is no joint, or one without a drive.
    """

    def __init__(self, env: BaseEnv, entity: ResolvedEntity, driven: bool = True) -> None:
        self._period = env.step_dt
        asset = entity.asset
        if not hasattr(asset, "parsed"):
            raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} has no joints")])
        if not entity.joint_ids:
            raise ConfigError([Problem("entity_cfg", f"{entity.uid!r} has no active joint")])
        self.names = entity.joint_names
        self._asset: Any = asset
        self._ids: NDArray[np.int64] = np.asarray(entity.joint_ids, np.int64)
        self._joints = None if entity.all_joints else self._ids
        actuators = np.asarray(asset.entity.actuator_ids)[self._ids]
        undriven = [n for n, a in zip(self.names, actuators, strict=True) if a < 0]
        if driven and undriven:
            message = f"joints {undriven} have no drive (drive_type none, or they mimic another)"
            raise ConfigError([Problem("entity_cfg", message)])
        self._default: F64 = np.asarray(asset.parsed.init_qpos, np.float64)[self._ids]

    def _write_targets(self, target: F64) -> None:
        """Set the drives' position targets (N, A), clamped to the joints' limits.

        In a control step they move by at most the drives' `max_velocity` times its period.
        """
        moved = self._asset.drives.within_rate(target, self._ids, self._period)
        self._asset.write_target(moved, self._joints)

    def _targets(self) -> F64:
        """(N, A) current position targets of the drives."""
        targets: F64 = self._asset.drives.read_target_qpos()[:, self._ids]
        return targets

    def _qpos(self) -> F64:
        """(N, A) measured positions: not to be written to or kept."""
        qpos: F64 = self._asset.read_qpos()
        return qpos if self._joints is None else qpos[:, self._ids]


class AffineJointTerm(JointTerm):
    """A joint term whose value is centre + scale x clamp(action, clip), in float64.

    The bounds of the action are `clip`; without one they follow from those of the value.

    Args:
        env: The environment.
        entity: The robot and the joints picked.
        scale: `PerJoint`, not 0; joints that a map leaves out get 1.
        offset: `PerJoint`; joints that a map leaves out get 0.
        clip: `JointClip`, or None.
        centre: (A,) added to the offset.
        limits: Low and high of the value, (A,) each, finite: needed without `clip`.
        driven: See `JointTerm`.
    """

    def __init__(
        self,
        env: BaseEnv,
        entity: ResolvedEntity,
        scale: Any,
        offset: Any,
        clip: Any,
        centre: F64 | float = 0.0,
        limits: tuple[Any, Any] | None = None,
        driven: bool = True,
    ) -> None:
        super().__init__(env, entity, driven)
        self._scale: F64 = per_joint(scale, self.names, "scale", 1.0)
        if (self._scale == 0).any():
            raise ConfigError([Problem("scale", "must not be 0")])
        self._centre: F64 = per_joint(offset, self.names, "offset", 0.0) + centre
        self._clips = clip is not None
        if clip is not None:
            self._least, self._most = joint_clip(clip, self.names, "clip")
        elif limits is not None:
            ends = (np.asarray(limits, np.float64) - self._centre) / self._scale
            self._least, self._most = np.minimum(*ends), np.maximum(*ends)
        self.low: NDArray[np.float32] = self._least.astype(np.float32)
        self.high: NDArray[np.float32] = self._most.astype(np.float32)
        self._plain = bool((self._scale == 1).all() and not self._centre.any())

    def _value(self, action: torch.Tensor) -> F64:
        """(N, A) the value of an action."""
        given: F64 = action.numpy()
        if self._clips:
            given = np.minimum(np.maximum(given, self.low), self.high)  # float32: no conversion
        return given if self._plain else self._centre + self._scale * given

    def _action_for(self, value: F64 | float) -> F64:
        """(A,) or (N, A) the action that gives a value, as far as the bounds allow."""
        found: F64 = np.clip((value - self._centre) / self._scale, self._least, self._most)
        return found
