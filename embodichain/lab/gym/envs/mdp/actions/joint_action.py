"""The action that moves joints: positions, velocities or efforts, affine in the action."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp.actions._affine import Affine
from embodichain.lab.gym.envs.mdp.actions._joint_term import Efforts, JointTerm, VelocityTargets
from embodichain.lab.gym.envs.mdp.actions._per_joint import JointClip, PerJoint
from embodichain.lab.gym.utils.bounds import finite_limits
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["JointAction"]

Centre = Literal["zero", "home", "qpos", "target", "limits"]


@register_term("action", name="joint_action")
class JointAction(JointTerm):
    """Joint targets or efforts: value = centre + offset + scale x clamp(action, clip).

    Computed in float64. Position targets are clamped to the joints' limits and move by at most
    ``max_velocity`` times the control period. With stiffness 0 a velocity is the drive's target,
    effort = damping x (target - velocity); with stiffness it moves the position target, which
    never runs further ahead than the drive can pull (``max_effort`` / stiffness), so that the joint
    is held at velocity 0. Efforts are applied to the joints themselves (MuJoCo's
    ``qfrc_applied``), beside what a drive does: declare ``drive_pros: {drive_type: none}`` or
    stiffness and damping 0 for pure effort control.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        control: What the value is: ``position`` (rad or m), ``velocity`` (rad/s or m/s), or
            ``effort`` (N m or N), within +-``max_effort``.
        centre: Of positions: ``zero``; ``home``, the initial position; ``qpos``, the measured
            position; ``target``, the previous target, so that nothing sags under gravity;
            ``limits`` maps `range` to the joint's declared limits (+-2 pi without any), with
            u = clamp(offset + scale x clamp(action, clip), range), target = low + (high - low) x
            (u - range[0]) / (range[1] - range[0]).
        scale: Units per unit of action: a number, one a joint, or {joint regex: number}.
        offset: Units, likewise.
        clip: Bounds of the action: [low, high], pairs one a joint, or {joint regex: [low, high]}.
            None is the joints' limits (+-2 pi without any) seen through scale and offset for
            positions about zero, `range` seen through them for ``limits``, else [-1, 1].
        range: [low, high]: what ``centre: limits`` maps to the joints' limits.

    Raises:
        ConfigError: If a joint has no drive, or not one for this control.

    Example:
        ``{func: joint_action, params: {entity_cfg: {uid: ur10}, centre: home, scale: 0.6}}``
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        control: Literal["position", "velocity", "effort"] = "position",
        centre: Centre = "zero",
        scale: PerJoint = 1.0,
        offset: PerJoint = 0.0,
        clip: JointClip | None = None,
        range: Range = (-1.0, 1.0),
    ) -> None:
        super().__init__(env, entity_cfg, control != "effort", control == "position")
        if control != "position" and centre != "zero":
            raise ConfigError([Problem("centre", f"{centre} has a meaning for positions only")])
        if range[0] == range[1]:
            raise ConfigError([Problem("range", f"low equals high in {list(range)}")])
        low, high = finite_limits(self._asset.parsed.qpos_limits, entity_cfg.joint_ids)
        ends = tuple(np.full(len(self._ids), float(end)) for end in range)
        limits: tuple[F64, F64] | None = None
        if centre == "limits":
            limits = ends[0], ends[1]
        elif control == "position" and centre == "zero":
            limits = low, high
        elif clip is None:
            clip = [-1.0, 1.0]
        home = self._default if centre == "home" else 0.0
        affine = Affine(self.names, scale, offset, clip, home, limits)
        self.low, self.high = affine.low, affine.high
        self._value, self._action_for = affine.value, affine.action_for
        self._start, self._end, self._joint_low = *ends, low
        self._slope: F64 = (high - low) / (ends[1] - ends[0])
        self._moves = control != "position" or centre in ("qpos", "target")
        self._maps = centre == "limits"
        self._write: Callable[[F64], Any] = self._write_targets
        self._reference = self._qpos if centre == "qpos" else self._targets
        if control == "velocity":
            self._write = VelocityTargets(self._asset, self._ids, env.step_dt).write
        elif control == "effort":
            self._write = Efforts(self._asset, self._ids).write
        elif centre in ("qpos", "target"):
            self._write = self._write_relative
        elif centre == "limits":
            self._write = self._write_mapped

    def apply(self, action: torch.Tensor) -> None:
        """Write the targets or efforts of (N, A) actions."""
        self._write(self._value(action))

    def _write_relative(self, value: F64) -> None:
        self._write_targets(self._reference() + value)

    def _write_mapped(self, value: F64) -> None:
        within = np.minimum(np.maximum(value, self._start), self._end)
        self._write_targets(self._joint_low + (within - self._start) * self._slope)

    def _action_at(self, position: F64) -> F64:
        """The action that gives position targets, as far as the bounds allow."""
        if self._maps:
            position = self._start + (position - self._joint_low) / self._slope
        return self._action_for(position)

    def home(self) -> F64:
        """(A,) the action that goes to the initial position, or that moves nothing."""
        return self._action_for(0.0) if self._moves else self._action_at(self._default)

    def hold(self) -> F64:
        """(N, A) or (A,) the action that keeps the present targets, or that moves nothing."""
        return self.home() if self._moves else self._action_at(self._targets())
