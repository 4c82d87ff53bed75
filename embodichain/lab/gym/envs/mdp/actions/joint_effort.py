"""The action that applies joint efforts."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp.actions._joint_term import AffineJointTerm
from embodichain.lab.gym.envs.mdp.actions._per_joint import JointClip, PerJoint

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["JointEffort"]

logger = logging.getLogger(__name__)


@register_term("action", name="joint_effort")
class JointEffort(AffineJointTerm):
    """Joint efforts: effort = offset + scale x clamp(action, clip), within +-``max_effort``.

    EmbodiChain's QfTerm, Isaac Lab's JointEffortAction. The effort is applied to the joint itself
    (MuJoCo's ``qfrc_applied``), constant over a control step, whatever the drive type: a drive that
    is there acts beside it, as in EmbodiChain. For pure effort control declare
    ``drive_pros: {drive_type: none}`` (URDF; the limit is then the file's) or stiffness and damping
    0 (a stiff drive would hold its own target; a warning says so). A randomized actuator strength
    scales what is applied.

    Example:
        ``{func: joint_effort, params: {entity_cfg: {uid: ur10}, scale: 10.0, clip: [-1, 1]}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        scale: N m or N per unit of action: a number, one a joint, or {joint regex: number}.
        offset: N m or N, likewise.
        clip: Bounds of the action: [low, high], pairs one a joint, or {joint regex: [low, high]}.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        scale: PerJoint = 1.0,
        offset: PerJoint = 0.0,
        clip: JointClip = (-1.0, 1.0),  # type: ignore[assignment]
    ) -> None:
        super().__init__(env, entity_cfg, scale, offset, clip, driven=False)
        self._dofs = np.asarray(self._asset.entity.dof_adr, np.int64)[self._ids]
        stiffness = self._asset.drives.stiffness[0, self._ids]
        stiff = [name for name, k in zip(self.names, stiffness, strict=True) if k > 0]
        if stiff:
            logger.warning(
                "joint_effort: joints %s have a drive with stiffness that holds its own target "
                "beside the effort; drive_pros: {stiffness: 0, damping: 0} leaves the effort alone",
                ", ".join(stiff),
            )

    def apply(self, action: torch.Tensor) -> None:
        """Apply the efforts of (N, A) actions, N m or N."""
        drives = self._asset.drives
        most = drives.max_effort[:, self._ids]
        effort = np.minimum(np.maximum(self._value(action), -most), most)
        effort = effort * drives.strength[:, self._ids]
        self._asset.engine.write("qfrc_applied", effort, None, self._dofs)

    def home(self) -> F64:
        """(A,) the action whose effort is 0, or the bound nearest to it."""
        return self._action_for(0.0)
