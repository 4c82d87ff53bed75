"""Observations of joints: positions, velocities, efforts, and shares of their limits.

Isaac Lab's and mjlab's ``joint_pos``, ``joint_pos_rel``, ``joint_vel`` and ``joint_vel_rel`` are
`joint_position`, `joint_position_relative` and (both) `joint_velocity` here: joints start at rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._joints import Joints, pick_joints
from embodichain.lab.gym.envs.mdp.observations._computed import Computed
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64
else:
    torch = lazy_loader.load("torch")

__all__ = [
    "JointEffort",
    "JointPosition",
    "JointPositionLimitNormalized",
    "JointPositionRelative",
    "JointVelocity",
    "NormalizeRobotJointData",
]


class _OfJoints(Computed):
    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._of = Joints(entity_cfg)


@register_term("observation", name="joint_position")
class JointPosition(_OfJoints):
    """(N, K) positions of the picked joints, rad or m. Isaac Lab's ``joint_pos``.

    Example:
        ``{func: joint_position, params: {entity_cfg: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
    """

    def value(self) -> F64:
        """(N, K)."""
        return self._of.qpos()


@register_term("observation", name="joint_position_relative")
class JointPositionRelative(_OfJoints):
    """(N, K) positions of the picked joints minus the initial ones, rad or m.

    Isaac Lab's ``joint_pos_rel``.

    Example:
        ``{func: joint_position_relative, params: {entity_cfg: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
    """

    def value(self) -> F64:
        """(N, K)."""
        return self._of.qpos() - self._of.home


@register_term("observation", name="joint_pos_limit_normalized")
class JointPositionLimitNormalized(_OfJoints):
    """(N, K) positions of the picked joints in their range: -1 at the lower limit, 1 at the upper.

    2 (q - low) / (high - low) - 1, with the limits in force; nothing is clipped. Isaac Lab's
    observation of the same name.

    Example:
        ``{func: joint_pos_limit_normalized, params: {entity_cfg: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.

    Raises:
        ConfigError: If a joint has no limits.
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        super().__init__(env, entity_cfg)
        limits = np.asarray(self._of.asset.parsed.qpos_limits, np.float64)[self._of.ids]
        _need_limits(self._of, np.isfinite(limits).all(axis=1), "entity_cfg", "position limits")

    def value(self) -> F64:
        """(N, K)."""
        low, high = self._of.asset.drives.limits.of(self._of.ids, None)
        found: F64 = 2.0 * (self._of.qpos() - low) / (high - low) - 1.0
        return found


@register_term("observation", name="joint_velocity")
class JointVelocity(_OfJoints):
    """(N, K) velocities of the picked joints, rad/s or m/s.

    Isaac Lab's ``joint_vel``, and its ``joint_vel_rel``: joints start at rest.

    Example:
        ``{func: joint_velocity, scale: 0.1, params: {entity_cfg: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
    """

    def value(self) -> F64:
        """(N, K)."""
        return self._of.qvel()


@register_term("observation", name="joint_effort")
class JointEffort(_OfJoints):
    """(N, K) efforts of the picked joints in the last physics step, N m or N.

    What drives, their damping and effort actions give together: Isaac Lab's ``joint_effort``, the
    applied torque. The damping of a joint without a drive counts as well.

    Example:
        ``{func: joint_effort, scale: 0.01, params: {entity_cfg: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
    """

    def value(self) -> F64:
        """(N, K)."""
        return self._of.effort()


@register_term("observation", name="normalize_robot_joint_data")
class NormalizeRobotJointData(Term):
    """Maps joint data of the robot from the joints' limits to a range: for ``mode: modify``.

    (x - low) / (high - low) x (range[1] - range[0]) + range[0] in the picked columns; other columns
    stay as they are, nothing is clipped. EmbodiChain's observation of the same name, for
    ``robot/qpos``, ``robot/qvel`` and ``robot/qf`` (or any entry with a column for each active
    joint). A hinge without position limits (URDF's ``continuous``) is mapped from [-pi, pi] rad.

    Example:
        ``{func: normalize_robot_joint_data, mode: modify, name: robot/qpos, params: {joint_ids:
        [0, 1]}}``

    Args:
        joint_ids: The columns, which are those of the active joints: joints that mimic another one
            have none. None (and no `control_parts`) is all of them.
        control_parts: One control part of the robot, instead.
        limit: ``qpos_limits`` in force; or the file's ``qvel_limits`` or ``qf_limits``, which reach
            from minus to plus the limit.
        range: [low, high] that the limits become.

    Raises:
        ConfigError: If a joint has no such limit.
    """

    def __init__(
        self,
        env: TermContext,
        joint_ids: list[int] | None = None,
        control_parts: str | None = None,
        limit: Literal["qpos_limits", "qvel_limits", "qf_limits"] = "qpos_limits",
        range: Range = (0.0, 1.0),
    ) -> None:
        active = list(env.active_joint_ids)
        self._columns = _active_columns(env, active, joint_ids, control_parts)
        self._width = len(active)
        self._of = pick_joints(env, None, None, [active[column] for column in self._columns])
        self._positions = limit == "qpos_limits"
        most: F64 = np.asarray(getattr(self._of.asset.parsed, limit), np.float64)[self._of.ids]
        self._most = most
        self._turning = np.zeros(len(most), np.bool_)
        if self._positions:
            self._turning = ~np.isfinite(most).any(axis=1) & self._of.hinges()
            limited = np.isfinite(most).all(axis=1) | self._turning
        else:  # a file that gives no velocity or effort says 0
            limited = np.isfinite(most) & (most > 0)
        _need_limits(self._of, limited, "limit", limit)
        self._start, self._span = float(range[0]), float(range[1]) - float(range[0])

    def __call__(self, env: TermContext, data: torch.Tensor) -> torch.Tensor:
        """(N, A) the data with the picked columns mapped."""
        if data.ndim != 2 or data.shape[1] != self._width:
            raise ValueError(
                f"normalize_robot_joint_data wants ({env.num_envs}, {self._width}), one column for "
                f"each active joint, got {tuple(data.shape)}"
            )
        values = data.numpy().astype(np.float64)
        low, high = -self._most, self._most
        if self._positions:
            low, high = self._of.asset.drives.limits.of(self._of.ids, None)
            low, high = np.where(self._turning, -np.pi, low), np.where(self._turning, np.pi, high)
        picked = values[:, self._columns]
        values[:, self._columns] = (picked - low) / (high - low) * self._span + self._start
        return torch.from_numpy(values.astype(np.float32))


def _active_columns(
    env: TermContext, active: list[int], joint_ids: list[int] | None, control_parts: str | None
) -> list[int]:
    """Columns among the active joints."""
    if control_parts is None or env.robot is None:
        columns = list(range(len(active))) if joint_ids is None else joint_ids
        strange = [column for column in columns if not 0 <= column < len(active)]
        if strange:
            message = (
                f"columns of the active joints, of which there are {len(active)}, numbered from 0; "
                f"got {strange}"
            )
            raise ConfigError([Problem("joint_ids", message)])
        return columns
    if joint_ids is not None:
        raise ConfigError([Problem("control_parts", "give either joint_ids or control_parts")])
    part = env.scene_entity({"uid": env.robot.uid, "control_parts": control_parts})
    idle = [n for n, i in zip(part.joint_names, part.joint_ids, strict=True) if i not in active]
    if idle:
        message = f"joints of {control_parts!r} are not active: {', '.join(idle)}"
        raise ConfigError([Problem("control_parts", message)])
    return [active.index(i) for i in part.joint_ids]


def _need_limits(joints: Joints, limited: Any, path: str, what: str) -> None:
    missing = [name for name, fine in zip(joints.names, limited, strict=True) if not fine]
    if missing:
        message = f"joints of {joints.uid!r} without {what}: {', '.join(missing)}"
        raise ConfigError([Problem(path, message)])
