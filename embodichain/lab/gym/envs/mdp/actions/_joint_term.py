"""Joints that actions move, and what is written to them: targets or efforts."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.term import ActionTerm
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.engine.base import F64

__all__ = ["Efforts", "JointTerm", "VelocityTargets"]

logger = logging.getLogger(__name__)


class JointTerm(ActionTerm):
    """An action term of the picked joints.

    Args:
        env: The environment.
        entity: The robot and the joints picked.
        driven: Whether every joint must have a drive.
        positions: Whether the drives must take position targets.

    Raises:
        ConfigError: If there is no joint, or one without such a drive.
    """

    def __init__(
        self,
        env: TermContext,
        entity: ResolvedEntity,
        driven: bool = True,
        positions: bool = True,
    ) -> None:
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
        if driven and positions and fast:
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


class VelocityTargets:
    """Writes velocity targets: a velocity drive's, or a moving position target of a stiff drive.

    Args:
        asset: The articulation.
        joints: (A,) indices of its joints.
        period: Seconds of a control step.

    Raises:
        ConfigError: If a joint has neither stiffness nor damping.
    """

    def __init__(self, asset: Any, joints: NDArray[np.int64], period: float) -> None:
        self._asset, self._joints, self._period = asset, joints, period
        drives = asset.drives
        stiff, damping = (v[0, joints] > 0 for v in (drives.stiffness, drives.damping))
        lame = [asset.parsed.joint_names[j] for j in joints[~(stiff | damping)]]
        if lame:
            message = f"joints {lame} have neither stiffness nor damping: nothing drives them"
            raise ConfigError([Problem("entity_cfg", message)])
        self._stiff: NDArray[np.int64] = np.flatnonzero(stiff)
        self._free: NDArray[np.int64] = np.flatnonzero(~stiff)

    def write(self, velocity: F64) -> None:
        """Set velocities (N, A), rad/s or m/s, within the drives' `max_velocity`."""
        most = self._asset.drives.max_velocity[:, self._joints]
        target = np.minimum(np.maximum(velocity.astype(np.float64), -most), most)
        if len(self._stiff):
            self._move(target[:, self._stiff])
        if len(self._free):
            joints = self._joints[self._free]
            self._asset.drives.write_target_qvel(target[:, self._free], joints, None)

    def _move(self, velocity: F64) -> None:
        """Move the position targets of stiff drives, as far ahead as the drives can pull."""
        joints, asset = self._joints[self._stiff], self._asset
        drives = asset.drives
        target = drives.read_target_qpos()[:, joints] + velocity * self._period
        reach = drives.max_effort[:, joints] / drives.stiffness[:, joints]
        qpos = asset.read_qpos()[:, joints]
        target = np.minimum(np.maximum(target, qpos - reach), qpos + reach)
        drives.target_qvel[:, joints] = velocity
        drives.has_velocity_target = True
        asset.write_target(target, joints)


class Efforts:
    """Applies efforts to joints, constant over a control step.

    Args:
        asset: The articulation.
        joints: (A,) indices of its joints.
    """

    def __init__(self, asset: Any, joints: NDArray[np.int64]) -> None:
        self._asset, self._joints = asset, joints
        self._dofs = np.asarray(asset.entity.dof_adr, np.int64)[joints]
        stiff = joints[asset.drives.stiffness[0, joints] > 0]
        if len(stiff):
            logger.warning(
                "joint_effort: joints %s have a drive with stiffness that holds its own target "
                "beside the effort; drive_pros: {stiffness: 0, damping: 0} leaves the effort alone",
                ", ".join(asset.parsed.joint_names[j] for j in stiff),
            )

    def write(self, effort: F64) -> None:
        """Apply (N, A) efforts, N m or N, within `max_effort`, times the drives' strength."""
        drives = self._asset.drives
        most = drives.max_effort[:, self._joints]
        effort = np.minimum(np.maximum(effort, -most), most) * drives.strength[:, self._joints]
        self._asset.engine.write("qfrc_applied", effort, None, self._dofs)
