"""What joint actions have in common: the joints, and value = centre + scale x clamp(action).

What is done with the value is each term's own business.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from embodichain.lab.gym.envs.managers.term import ActionTerm
from embodichain.lab.gym.envs.mdp.actions._affine import Affine
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
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
        ConfigError: If there is no joint, or one without a drive, or one whose servo in the file
            takes velocity targets only.
    """

    sets_position: ClassVar[bool] = True
    """Whether it needs drives that take position targets."""

    def __init__(self, env: TermContext, entity: ResolvedEntity, driven: bool = True) -> None:
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
            message = (
                f"joints {undriven} have no drive and no position servo (drive_type none, mimics, "
                "or joints of an MJCF that its actuators or drive_pros leave alone)"
            )
            raise ConfigError([Problem("entity_cfg", message)])
        parsed = asset.parsed
        speeds = (parsed.servos.drive >= 0) & ~parsed.driven & (parsed.stiffness == 0)
        fast = [n for n, i in zip(self.names, self._ids, strict=True) if speeds[i]]
        if driven and self.sets_position and fast:
            names = ", ".join(map(repr, fast))
            message = f"joints {names} take velocity targets only: use joint_velocity"
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
    """A joint term whose value is affine in the action.

    Args:
        env: The environment.
        entity: The robot and the joints picked.
        scale, offset, clip, centre, limits: See `Affine`.
        driven: See `JointTerm`.
    """

    def __init__(
        self,
        env: TermContext,
        entity: ResolvedEntity,
        scale: Any,
        offset: Any,
        clip: Any,
        centre: F64 | float = 0.0,
        limits: tuple[Any, Any] | None = None,
        driven: bool = True,
    ) -> None:
        super().__init__(env, entity, driven)
        affine = Affine(self.names, scale, offset, clip, centre, limits)
        self.low, self.high = affine.low, affine.high
        self._value, self._action_for = affine.value, affine.action_for
