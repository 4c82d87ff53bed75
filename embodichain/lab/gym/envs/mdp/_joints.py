"""`Joints`: the picked joints of an articulation as float64 columns, with their limits.

Also EmbodiChain's way to pick them, by robot, indices or control part.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["UNLIMITED", "Joints", "as_parameters", "pick_joints", "wrapped"]

_HINGE = 3
"""MuJoCo's ``mjJNT_HINGE``: modules of terms are listed without MuJoCo."""
UNLIMITED = 1e9
"""Speeds and efforts at least this large are no limits (EmbodiChain's default is 1e10)."""


class Joints:
    """K joints of an articulation in N environments.

    Args:
        entity: The articulation and the joints picked.

    Attributes:
        ids: (K,) their indices.
        names: Their names.
        home: (K,) initial positions, rad or m.

    Raises:
        ConfigError: If the entity has no joints.
    """

    def __init__(self, entity: ResolvedEntity) -> None:
        if not entity.joint_ids:
            raise ConfigError([Problem("entity_cfg", f"{entity.uid!r} has no joints")])
        self.uid = entity.uid
        self.asset = entity.asset
        self.names = entity.joint_names
        self.ids: NDArray[np.int64] = np.asarray(entity.joint_ids, np.int64)
        self._all = entity.all_joints
        self.home: F64 = np.asarray(self.asset.parsed.init_qpos, np.float64)[self.ids]
        self._dofs = np.asarray(self.asset.entity.dof_adr, np.int64)[self.ids]

    def _pick(self, values: F64) -> F64:
        return values if self._all else values[:, self.ids]

    def qpos(self) -> F64:
        """(N, K) positions, rad or m: not to be written to or kept."""
        return self._pick(self.asset.read_qpos())

    def qvel(self) -> F64:
        """(N, K) velocities, rad/s or m/s: not to be written to or kept."""
        return self._pick(self.asset.read_qvel())

    def effort(self) -> F64:
        """(N, K) N m or N of the last physics step: drive, its damper, and efforts applied."""
        applied = self.asset.engine.state("qfrc_applied")[:, self._dofs]
        found: F64 = self._pick(self.asset.read_qf()) + applied
        return found

    def hinges(self) -> NDArray[np.bool_]:
        """(K,) whether a joint turns, instead of sliding."""
        model = self.asset.engine.model
        kinds = model.jnt_type[model.dof_jntid[self._dofs]]
        turns: NDArray[np.bool_] = kinds == _HINGE
        return turns

    # -- limits ----------------------------------------------------------------------------------

    def position_limits(self, soft_ratio: float = 1.0) -> tuple[F64, F64]:
        """Low and high in force, (K,) or (N, K) each; infinite without a limit.

        Args:
            soft_ratio: How much of the range counts, around its middle.

        Raises:
            ConfigError: If no joint has a limit.
        """
        low, high = self.asset.drives.limits.of(self.ids, None)
        self._need(bool((np.isfinite(low) | np.isfinite(high)).any()), "position")
        if soft_ratio == 1.0:
            return low, high
        limited = np.isfinite(low) & np.isfinite(high)
        width = np.subtract(high, low, where=limited, out=np.zeros_like(low))
        inset = 0.5 * (1.0 - soft_ratio) * width
        return low + inset, high - inset

    def velocity_limits(self) -> F64:
        """(N, K) rad/s or m/s: the smaller of the drive's maximum and the file's limit."""
        most = np.asarray(self.asset.parsed.qvel_limits, np.float64)
        return self._smaller(self.asset.drives.max_velocity, most, "velocity")

    def effort_limits(self) -> F64:
        """(N, K) N m or N: the smaller of what the drive yields at most and the file's limit."""
        most = np.asarray(self.asset.parsed.qf_limits, np.float64)
        drives = self.asset.drives
        return self._smaller(drives.max_effort * drives.strength, most, "effort")

    def _smaller(self, drive: F64, file: F64, what: str) -> F64:
        limits = np.minimum(drive[:, self.ids], file[self.ids])
        limits = np.where(limits >= UNLIMITED, np.inf, limits)
        self._need(bool(np.isfinite(limits).any()), what)
        return limits

    def _need(self, limited: bool, what: str) -> None:
        if not limited:
            names = ", ".join(self.names)
            message = f"none of the joints picked of {self.uid!r} has limits of {what}: {names}"
            raise ConfigError([Problem("entity_cfg", message)])


def pick_joints(
    env: TermContext,
    entity_cfg: ResolvedEntity | None,
    robot_uid: str | None,
    joint_ids: Sequence[int] | None,
    part_name: str | None = None,
) -> Joints:
    """Joints given by a reference, or as EmbodiChain does.

    Args:
        env: The environment.
        entity_cfg: The reference; the others must then be None.
        robot_uid: A robot; None is the task's own.
        joint_ids: Its joints; None is all active ones.
        part_name: A control part, instead of indices.

    Raises:
        ConfigError: If there is no such robot, joint or part, or both ways are mixed.
    """
    given = {"robot_uid": robot_uid, "joint_ids": joint_ids, "part_name": part_name}
    mixed = [name for name, value in given.items() if value is not None]
    if entity_cfg is not None:
        if mixed:
            raise ConfigError([Problem(mixed[0], "give either entity_cfg or this")])
        return Joints(entity_cfg)
    if joint_ids is not None and part_name is not None:
        raise ConfigError([Problem("part_name", "give either joint_ids or part_name")])
    if robot_uid is None:
        if env.robot is None:
            raise ConfigError([Problem("robot_uid", "the task has no robot: give entity_cfg")])
        robot_uid = env.robot.uid
    cfg: dict[str, Any] = {"uid": robot_uid, "control_parts": part_name}
    if joint_ids is not None:
        cfg = {"uid": robot_uid, "joint_ids": list(joint_ids)}
    with as_parameters({"uid": "robot_uid", "control_parts": "part_name"}):
        return Joints(env.scene_entity(cfg))


@contextmanager
def as_parameters(names: Mapping[str, str]) -> Iterator[None]:
    """Call the keys of a reference what the term's parameters are called, in errors.

    Args:
        names: Key -> parameter.
    """
    try:
        yield
    except ConfigError as error:
        raise ConfigError(
            Problem(names.get(p.path, p.path), p.message, p.hint) for p in error.problems
        ) from error


def wrapped(angles: F64) -> F64:
    """Angles brought into [-pi, pi) rad."""
    turn = 2.0 * math.pi
    return angles - turn * np.floor((angles + math.pi) / turn)
