"""Commands that ask a robot to move at a velocity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import NonNegative, Range, UnitInterval
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import CommandMarker, CommandTerm, Uniform
from embodichain.lab.gym.envs.mdp._rows import norm
from embodichain.utils.configclass import configclass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import F64, EnvIndex

__all__ = ["UniformVelocityCommand", "VelocityRanges"]


@configclass
class VelocityRanges:
    """[low, high] of each column; `heading` is needed by environments that turn to a heading."""

    lin_vel_x: Range = (0.0, 0.0)
    """m/s, forward."""
    lin_vel_y: Range = (0.0, 0.0)
    """m/s, to the left."""
    ang_vel_z: Range = (0.0, 0.0)
    """rad/s, counter-clockwise."""
    heading: Range | None = None
    """rad, direction of the robot's x axis in the plane."""


@register_term("command", name="uniform_velocity")
class UniformVelocityCommand(CommandTerm):
    """(N, 3) velocity [vx, vy, wz] in the robot's heading frame, m/s and rad/s, drawn uniformly.

    Isaac Lab's ``UniformVelocityCommand``. The metrics ``error_vel_xy`` (m/s) and ``error_vel_yaw``
    (rad/s) are the distances of the root's velocity in its heading frame from the command.

    Example:
        ``{func: uniform_velocity, params: {of: {uid: go}, ranges: {lin_vel_x: [-1, 1]}}}``

    Args:
        entity_cfg: The robot; its root, or the picked link, is what should move.
        ranges: [low, high] of ``lin_vel_x``, ``lin_vel_y`` (m/s), ``ang_vel_z`` (rad/s) and, if
            environments should turn to a heading, ``heading`` (rad).
        heading_control_stiffness: Turning rate a radian of heading error, 1/s: wz is this times
            the error, clipped to the range of ``ang_vel_z``, recomputed in every step.
        rel_standing_envs: Share of draws that command zero.
        rel_heading_envs: Share of draws that turn to a heading; without the range ``heading`` none.
    """

    names = ("lin_vel_x", "lin_vel_y", "ang_vel_z")

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        ranges: VelocityRanges,
        heading_control_stiffness: NonNegative = 1.0,
        rel_standing_envs: UnitInterval = 0.0,
        rel_heading_envs: UnitInterval = 1.0,
    ) -> None:
        count = env.num_envs
        self._env = env
        self._entity = entity_cfg
        heading = ranges.heading
        self._turns = heading is not None and rel_heading_envs > 0
        rows = [ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z, heading or (0.0, 0.0)]
        low, high = ([*(row[i] for row in rows), float(i), float(i)] for i in (0, 1))
        self._drawn = Uniform("velocity", low, high)
        self._stiffness = heading_control_stiffness
        self._stands = rel_standing_envs
        self._heads = rel_heading_envs
        self.values: F64 = np.zeros((count, 3))
        self.marker = CommandMarker("velocity", entity_cfg.body_id)
        self.heading_target: F64 = np.zeros(count)
        self.is_heading: NDArray[np.bool_] = np.zeros(count, np.bool_)
        self.is_standing: NDArray[np.bool_] = np.zeros(count, np.bool_)

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw velocities, headings, and who stands or turns to a heading."""
        drawn = self._drawn(self._env.command_manager, env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        standing = drawn[:, 4] < self._stands
        self.is_standing[where] = standing
        self.is_heading[where] = self._turns & (drawn[:, 5] < self._heads)
        self.heading_target[where] = drawn[:, 3]
        self.values[where] = np.where(standing[:, None], 0.0, drawn[:, :3])

    def update(self, env_ids: EnvIndex | None) -> None:
        """Turn towards the heading, where one is commanded."""
        if not self._turns:
            return
        where: Any = slice(None) if env_ids is None else env_ids
        error = _wrapped(self.heading_target - _yaw(self._entity.orientation()))
        rate = np.clip(self._stiffness * error, self._drawn.low[2], self._drawn.high[2])
        turning = (self.is_heading & ~self.is_standing)[where]
        self.values[where, 2] = np.where(turning, rate[where], self.values[where, 2])

    def metrics(self) -> Mapping[str, F64]:
        """Distance of the velocity from the command: in the plane, and of turning."""
        difference = self._entity.linear_velocity("yaw")[:, :2] - self.values[:, :2]
        turning = self._entity.angular_velocity()[:, 2]
        return {
            "error_vel_xy": norm(difference),
            "error_vel_yaw": np.abs(turning - self.values[:, 2]),
        }

    def state_dict(self) -> dict[str, Any]:
        """Commands, headings, and who stands or turns."""
        return {
            **super().state_dict(),
            "heading_target": self.heading_target.copy(),
            "is_heading": self.is_heading.copy(),
            "is_standing": self.is_standing.copy(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self.heading_target[:] = state["heading_target"]
        self.is_heading[:] = state["is_heading"]
        self.is_standing[:] = state["is_standing"]


def _yaw(quat: F64) -> F64:
    """(N,) direction of the x axis in the plane, rad, of wxyz quaternions (N, 4)."""
    w, x, y, z = (quat[:, i] for i in range(4))
    # The products are contiguous, which transcendental functions need to round alike for any N.
    yaw: F64 = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    return yaw


def _wrapped(angle: F64) -> F64:
    """(N,) the same angles within [-pi, pi)."""
    wrapped: F64 = angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))
    return wrapped
