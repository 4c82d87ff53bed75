"""Actions that set joint position targets: absolute, around the initial ones, relative, to limits.

End-effector actions (a pose of the tool, absolute or relative) are not here: they need an IK solver
and will stand beside this module as ``eef_pose.py``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp.actions._joint_term import AffineJointTerm
from embodichain.lab.gym.envs.mdp.actions._per_joint import JointClip, PerJoint
from embodichain.lab.gym.utils.bounds import finite_limits
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "DefaultOffsetJointPosition",
    "JointPosition",
    "JointPositionToLimits",
    "RelativeJointPosition",
]


class _Targets(AffineJointTerm):
    """A value that is the drives' position target as it is."""

    def apply(self, action: torch.Tensor) -> None:
        """Write the targets of (N, A) actions, rad or m."""
        self._write_targets(self._value(action))

    def home(self) -> F64:
        """(A,) the action that goes to the initial position, within the bounds."""
        return self._action_for(self._default)

    def hold(self) -> F64:
        """(N, A) the action that keeps the present targets, within the bounds."""
        return self._action_for(self._targets())


@register_term("action", name="joint_position")
class JointPosition(_Targets):
    """Absolute joint position targets: target = offset + scale x clamp(action, clip).

    Isaac Lab's JointPositionAction with ``use_default_offset: false``; EmbodiChain's QposTerm. The
    drives clamp targets to the joints' limits.

    Example:
        ``{func: joint_position, params: {entity_cfg: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        scale: rad or m per unit of action: a number, one a joint, or {joint regex: number}.
        offset: rad or m, likewise.
        clip: Bounds of the action: [low, high], pairs one a joint, or {joint regex: [low, high]}.
            Without it they are the joints' limits, seen through scale and offset (for a joint
            without limits those of +-2 pi).
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        scale: PerJoint = 1.0,
        offset: PerJoint = 0.0,
        clip: JointClip | None = None,
    ) -> None:
        super().__init__(env, entity_cfg, scale, offset, clip, limits=_limits(entity_cfg))


@register_term("action", name="default_offset_joint_position")
class DefaultOffsetJointPosition(_Targets):
    """Joint position targets around the initial position, for learners.

    target = init_qpos + offset + scale x clamp(action, clip), computed in float64; the bounds are
    `clip`. EmbodiChain 0.3's joint_position.default_offset contract; Isaac Lab's
    JointPositionAction with ``use_default_offset: true``.

    Example:
        ``{func: default_offset_joint_position, params: {entity_cfg: {uid: ur10}, scale: 0.6}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        scale: rad or m per unit of action: a number, one a joint, or {joint regex: number}.
        clip: Bounds of the action: [low, high], pairs one a joint, or {joint regex: [low, high]}.
        offset: rad or m, as `scale`.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        scale: PerJoint = 1.0,
        clip: JointClip = (-1.0, 1.0),  # type: ignore[assignment]
        offset: PerJoint = 0.0,
    ) -> None:
        parsed = getattr(entity_cfg.asset, "parsed", None)
        ids = list(entity_cfg.joint_ids)
        home = 0.0 if parsed is None else np.asarray(parsed.init_qpos, np.float64)[ids]
        super().__init__(env, entity_cfg, scale, offset, clip, centre=home)


@register_term("action", name="relative_joint_position")
class RelativeJointPosition(AffineJointTerm):
    """Joint position targets relative to where the joints are now.

    target = reference + offset + scale x clamp(action, clip), taken once a control step.
    EmbodiChain's DeltaQposTerm, which works on any choice of joints here, and Isaac Lab's
    RelativeJointPositionAction, except that Isaac Lab adds to the position anew in every physics
    step within the control step.

    Example:
        ``{func: relative_joint_position, params: {entity_cfg: {uid: ur10}, scale: 0.05}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        scale: rad or m per unit of action: a number, one a joint, or {joint regex: number}.
        clip: Bounds of the action: [low, high], pairs one a joint, or {joint regex: [low, high]}.
        offset: rad or m, as `scale`.
        reference: ``qpos`` adds to the measured position; ``target`` to the previous target, so
            that nothing sags under gravity.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        scale: PerJoint = 1.0,
        clip: JointClip = (-1.0, 1.0),  # type: ignore[assignment]
        offset: PerJoint = 0.0,
        reference: Literal["qpos", "target"] = "qpos",
    ) -> None:
        super().__init__(env, entity_cfg, scale, offset, clip)
        self._reference = self._qpos if reference == "qpos" else self._targets

    def apply(self, action: torch.Tensor) -> None:
        """Write targets for (N, A) actions."""
        self._write_targets(self._reference() + self._value(action))

    def home(self) -> F64:
        """(A,) the action that moves nothing: where the initial state is depends on where it is."""
        return self._action_for(0.0)


@register_term("action", name="joint_position_to_limits")
class JointPositionToLimits(AffineJointTerm):
    """Joint position targets over the joints' whole range.

    With u = clamp(offset + scale x clamp(action, clip), range), target = low + (high - low) x
    (u - range[0]) / (range[1] - range[0]), low and high the joint's declared limits (+-2 pi without
    any); where an event has narrowed them, the drive clamps.
    EmbodiChain's QposDenormalizedTerm; Isaac Lab's JointPositionToLimitsAction.

    Example:
        ``{func: joint_position_to_limits, params: {entity_cfg: {uid: ur10}, range: [-1, 1]}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        scale: Of the action, before it is mapped: a number, one a joint, or {joint regex: number}.
        range: [low, high]: what is mapped to the joints' limits.
        offset: Of the action, as `scale`.
        clip: Bounds of the action: [low, high], pairs one a joint, or {joint regex: [low, high]}.
            Without it they are those that `range` asks for.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        scale: PerJoint = 1.0,
        range: Range = (-1.0, 1.0),
        offset: PerJoint = 0.0,
        clip: JointClip | None = None,
    ) -> None:
        if range[0] == range[1]:
            raise ConfigError([Problem("range", f"low equals high in {list(range)}")])
        count = len(entity_cfg.joint_ids)
        ends = tuple(np.full(count, float(end)) for end in range)
        super().__init__(env, entity_cfg, scale, offset, clip, limits=(ends[0], ends[1]))
        self._start, self._end = ends
        self._joint_low, high = _limits(entity_cfg)
        self._slope: F64 = (high - self._joint_low) / (self._end - self._start)

    def apply(self, action: torch.Tensor) -> None:
        """Write the targets of (N, A) actions, rad or m."""
        value = np.minimum(np.maximum(self._value(action), self._start), self._end)
        self._write_targets(self._joint_low + (value - self._start) * self._slope)

    def _action_at(self, position: F64) -> F64:
        return self._action_for(self._start + (position - self._joint_low) / self._slope)

    def home(self) -> F64:
        """(A,) the action that goes to the initial position, within the bounds."""
        return self._action_at(self._default)

    def hold(self) -> F64:
        """(N, A) the action that keeps the present targets, within the bounds."""
        return self._action_at(self._targets())


def _limits(entity: ResolvedEntity) -> tuple[F64, F64]:
    """Low and high, (A,) each, finite; empty for an entity without joints, which is refused."""
    parsed = getattr(entity.asset, "parsed", None)
    if parsed is None:
        return np.zeros(0), np.zeros(0)
    return finite_limits(parsed.qpos_limits, entity.joint_ids)
