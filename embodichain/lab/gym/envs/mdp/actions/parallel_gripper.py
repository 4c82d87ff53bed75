"""The action that opens and closes a parallel gripper with one number."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import finite_limits
from embodichain.lab.gym.envs.mdp.actions.joint_action import (
    JointTerm,
    PerJoint,
    per_joint,
)
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import F64

__all__ = ["ParallelGripper"]


@register_term("action", name="parallel_gripper")
class ParallelGripper(JointTerm):
    """One action in [-1, 1] for all joints of a gripper, as position targets.

    ``continuous``: target = lower + (upper - lower) x (action + 1) / 2, lower and upper the joints'
    limits or `lower_command` and `upper_command`. ``binary``: below 0 the targets are
    `close_command`, else `open_command`, as in Isaac Lab's BinaryJointPositionAction. EmbodiChain
    0.3's ParallelGripperAction.

    Example:
        ``{func: parallel_gripper, params: {of: {uid: panda, joint_names: ".*finger.*1"}}}``

    Args:
        entity_cfg: The robot and the joints of its gripper.
        command_mode: ``continuous`` or ``binary``.
        use_joint_limits: Whether lower and upper are the joints' limits; false (or null where
            commands are given) takes the commands.
        lower_command: rad or m at action -1: a number, a list per joint, or {joint regex: number}.
        upper_command: At action +1, likewise.
        open_command: rad or m, likewise; binary mode needs it.
        close_command: Likewise.

    Raises:
        ConfigError: If commands of the mode are missing, commands of the other mode are given, or
            both ends are the same.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        command_mode: Literal["continuous", "binary"] = "continuous",
        use_joint_limits: bool | None = None,
        lower_command: PerJoint | None = None,
        upper_command: PerJoint | None = None,
        open_command: PerJoint | None = None,
        close_command: PerJoint | None = None,
    ) -> None:
        super().__init__(env, entity_cfg)
        self._binary = command_mode == "binary"
        ends = {"lower_command": lower_command, "upper_command": upper_command}
        states = {"close_command": close_command, "open_command": open_command}
        wanted, other = (states, ends) if self._binary else (ends, states)
        strange = [name for name, value in other.items() if value is not None]
        if self._binary and use_joint_limits:
            strange.append("use_joint_limits")
        if strange:
            raise ConfigError(
                [Problem(n, f"has no meaning in mode {command_mode}") for n in strange]
            )
        if use_joint_limits is None:
            use_joint_limits = not self._binary and lower_command is upper_command is None
        if use_joint_limits:
            self._low, self._high = self._joint_limits(wanted)
        else:
            self._low, self._high = self._commands(wanted)
        self._span: F64 = self._high - self._low
        if not self._span.any():
            raise ConfigError([Problem(next(iter(wanted)), "both ends are the same")])
        self.low: NDArray[np.float32] = np.full(1, -1, np.float32)
        self.high: NDArray[np.float32] = np.full(1, 1, np.float32)
        self._names, self.names = self.names, ("gripper",)

    def _joint_limits(self, commands: dict[str, Any]) -> tuple[F64, F64]:
        given = [name for name, value in commands.items() if value is not None]
        if given:
            raise ConfigError([Problem(n, "contradicts use_joint_limits: true") for n in given])
        limits = np.asarray(self._asset.parsed.qpos_limits, np.float64)
        if not np.isfinite(limits[self._ids]).all():
            message = f"joints {list(self.names)} need limits, or give lower_ and upper_command"
            raise ConfigError([Problem("use_joint_limits", message)])
        return finite_limits(limits, self._ids)

    def _commands(self, commands: dict[str, Any]) -> tuple[F64, F64]:
        missing = [name for name, value in commands.items() if value is None]
        if missing:
            raise ConfigError([Problem(name, "missing; this mode needs it") for name in missing])
        low, high = (per_joint(value, self.names, name) for name, value in commands.items())
        return low, high

    def apply(self, action: torch.Tensor) -> None:
        """Write the targets of (N, 1) actions."""
        given = np.minimum(np.maximum(action.numpy().astype(np.float64), -1.0), 1.0)
        if self._binary:
            self._write_targets(np.where(given < 0.0, self._low, self._high))
        else:
            self._write_targets(self._low + self._span * (0.5 * (given + 1.0)))

    def _action_at(self, position: F64) -> F64:
        """(..., 1) the action nearest to positions (..., A): the mean over the joints that move."""
        moving = np.flatnonzero(self._span)
        shares = ((position - self._low)[..., moving] / self._span[moving]).T
        found = shares[0]
        for share in shares[1:]:
            found = found + share
        value: F64 = np.clip(2.0 * np.asarray(found) / len(moving) - 1.0, -1.0, 1.0)
        return np.where(value < 0.0, -1.0, 1.0)[..., None] if self._binary else value[..., None]

    def home(self) -> F64:
        """(1,) the action nearest to the initial state."""
        return self._action_at(self._default)

    def hold(self) -> F64:
        """(N, 1) the action nearest to the present targets."""
        return self._action_at(self._targets())
