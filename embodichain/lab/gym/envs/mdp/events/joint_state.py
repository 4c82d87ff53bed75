"""The event that sets joints to a random state about their initial one, and drive targets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import JointRange, Range, Whole
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.per_name import ranges_in_columns
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._model_fields import Operation
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = ["ResetJoints"]


@register_term("event", name="reset_joints")
class ResetJoints(Term):
    """Sets joints to random positions about their initial ones, with random velocities.

    qpos = clip(qpos0 + U(position_range), limits), qvel = qvel0 + U(velocity_range), one draw per
    joint. qpos0 and qvel0 are the initial ones; qvel0 is 0 unless a keyframe has velocities. Drive
    targets are set to the positions.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        position_range: [low, high] in rad or m for all picked joints, [[low, ...], [high, ...]]
            with one value per joint, or {joint regex: [low, high]}, which must name all of them.
        velocity_range: [low, high] in rad/s or m/s, or factors; [0, 0] draws nothing.
        operation: Whether a drawn position and velocity is added to the initial one (``add``),
            multiplies it (``scale``) or replaces it (``abs``).

    Example:
        ``{func: reset_joints, mode: reset, params: {of: {uid: ur10}, position_range: [-0.1, 0.1], velocity_range: [-0.2, 0.2]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        position_range: JointRange,
        velocity_range: Range = (0.0, 0.0),
        operation: Operation = "add",
    ) -> None:
        if not entity_cfg.joint_ids:
            raise ConfigError([Problem("entity_cfg.uid", f"{entity_cfg.uid!r} has no joints")])
        asset = entity_cfg.articulation
        self._asset = asset
        self._joints: NDArray[np.int64] = np.asarray(entity_cfg.joint_ids, np.int64)
        count = len(self._joints)
        self._dofs = np.asarray(asset.index.dof_adr, np.int64)[self._joints]
        self._initial_qpos = entity_cfg.initial_qpos
        initial_qvel: Floats = np.asarray(asset.parsed.init_qvel, np.float64)[self._joints]
        # A plain 0 where no keyframe has velocities, so that one number is written for all joints.
        self._initial_qvel: Any = initial_qvel if initial_qvel.any() else 0.0
        self._limits: Floats = np.asarray(asset.parsed.qpos_limits, np.float64)[self._joints]
        has_drive = np.asarray(asset.index.actuator_ids)[self._joints] >= 0
        self._driven: NDArray[np.int64] = np.flatnonzero(has_drive)
        self._operation = operation
        rows: Any = position_range
        has_rows = isinstance(rows, (list, tuple)) and isinstance(rows[0], (list, tuple))
        if has_rows and any(len(row) != count for row in rows):
            message = f"needs [low, high] or two rows of {count} values, got {rows}"
            raise ConfigError([Problem("position_range", message)])
        low, high = ranges_in_columns(
            position_range, entity_cfg.joint_names, "position_range", entity_cfg.joints_by
        )
        self._position = Uniform("position", low, high)
        self._velocity: Uniform | None = None
        if tuple(velocity_range) != (0.0, 0.0):
            lowest, highest = velocity_range
            self._velocity = Uniform("velocity", np.full(count, lowest), np.full(count, highest))

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the joint states of these environments."""
        asset = self._asset
        qpos = self._position(env.event_manager, env_ids)
        qvel: Any = 0.0
        if self._velocity is not None:
            qvel = self._velocity(env.event_manager, env_ids)
        if self._operation == "add":
            qpos = self._initial_qpos + qpos
            qvel = self._initial_qvel + qvel
        elif self._operation == "scale":
            qpos = self._initial_qpos * qpos
            qvel = self._initial_qvel * qvel
        qpos = np.clip(qpos, self._limits[:, 0], self._limits[:, 1])
        asset.write_qpos(qpos, self._joints, env_ids)
        asset.engine.write("qvel", qvel, env_ids, self._dofs)
        if len(self._driven):
            asset.write_target(qpos[:, self._driven], self._joints[self._driven], env_ids)
