"""The action that sets joint velocity targets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp.actions._joint_term import AffineJointTerm
from embodichain.lab.gym.envs.mdp.actions._per_joint import JointClip, PerJoint
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["JointVelocity"]


@register_term("action", name="joint_velocity")
class JointVelocity(AffineJointTerm):
    """Joint velocity targets: target = offset + scale x clamp(action, clip).

    EmbodiChain's QvelTerm, Isaac Lab's JointVelocityAction. What it does depends on the drive:

    * Stiffness 0: a velocity drive, effort = damping x (target - velocity) within ``max_effort``.
    * Stiffness above 0: the drive follows a position target that moves at the target velocity, so
      at velocity 0 the joint is held against gravity. The target never runs further ahead than the
      drive can pull (``max_effort`` / stiffness) nor beyond the joint's limits.

    Targets stay within ``max_velocity`` where the drive has one.

    Example:
        ``{func: joint_velocity, params: {entity_cfg: {uid: ur10}, scale: {"Joint.*": 0.5}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        scale: rad/s or m/s per unit of action: a number, one a joint, or {joint regex: number}.
        offset: rad/s or m/s, likewise.
        clip: Bounds of the action: [low, high], pairs one a joint, or {joint regex: [low, high]}.

    Raises:
        ConfigError: If a joint has no drive, or neither stiffness nor damping.
    """

    sets_position = False

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        scale: PerJoint = 1.0,
        offset: PerJoint = 0.0,
        clip: JointClip = (-1.0, 1.0),  # type: ignore[assignment]
    ) -> None:
        super().__init__(env, entity_cfg, scale, offset, clip)
        drives = self._asset.drives
        stiff, damping = (v[0, self._ids] > 0 for v in (drives.stiffness, drives.damping))
        lame = [n for n, k, d in zip(self.names, stiff, damping, strict=True) if not (k or d)]
        if lame:
            message = f"joints {lame} have neither stiffness nor damping: nothing drives them"
            raise ConfigError([Problem("entity_cfg", message)])
        self._stiff: NDArray[np.int64] = np.flatnonzero(stiff)
        self._free: NDArray[np.int64] = np.flatnonzero(~stiff)

    def apply(self, action: torch.Tensor) -> None:
        """Write the velocity targets of (N, A) actions, rad/s or m/s."""
        most = self._asset.drives.max_velocity[:, self._ids]
        target = np.minimum(np.maximum(self._value(action).astype(np.float64), -most), most)
        if len(self._stiff):
            self._move(target[:, self._stiff])
        if len(self._free):
            self._asset.drives.write_target_qvel(target[:, self._free], self._ids[self._free], None)

    def _move(self, velocity: F64) -> None:
        """Let the position targets of stiff drives move on."""
        joints, asset = self._ids[self._stiff], self._asset
        drives = asset.drives
        target = drives.read_target_qpos()[:, joints] + velocity * self._period
        reach = drives.max_effort[:, joints] / drives.stiffness[:, joints]
        qpos = asset.read_qpos()[:, joints]
        target = np.minimum(np.maximum(target, qpos - reach), qpos + reach)
        drives.target_qvel[:, joints] = velocity
        drives.has_velocity_target = True
        asset.write_target(target, joints)

    def home(self) -> F64:
        """(A,) the action whose velocity is 0, or the bound nearest to it."""
        return self._action_for(0.0)
