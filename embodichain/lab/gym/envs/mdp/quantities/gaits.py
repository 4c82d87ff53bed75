"""`FeetGait`: how well the feet of a legged robot keep to a gait with a given period.

For flat ground at height 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import (
    ContactOf,
    NonNegative,
    Positive,
    VelocityCommand,
)
from embodichain.lab.gym.envs.managers.terms.per_name import PerJoint, per_joint
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import mean, norm, squares
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = ["FeetGait"]

_SWING_EDGE = 1e-3
"""Sine above which a foot swings: the sine of half a period is rounded to either sign."""


@quantity("reward", "metric", name="feet_gait")
class FeetGait:
    """(N,) mean over feet, 0 to 1, of how well each keeps to its phase of a gait.

    With s = sin(2 pi (t / period + offset)), t the episode's time as in `phase`: while s > 0 a foot
    swings, and has exp(-((h - height s) / width)^2) for its height h above `rest_height` and the
    ground, which may be a terrain; else it stands, and has 1 if it is in contact. Where the command
    is small, all feet stand.

    Args:
        sensor: A contact sensor on the feet.
        period_s: Seconds per cycle.
        offsets: Phase of each foot at t = 0, in periods: a number, {link regex: number}, or a list
            whose numbers go with the plain names of the sensor's links (in the entity's order if
            the sensor names none).
        height: Height in the middle of the swing, m.
        width: Error of the height at which a swinging foot has exp(-1), m.
        rest_height: Height of a foot's origin while it stands on the ground, m.
        command_name: A command (vx, vy, wz); None: the robot always walks.
        min_command: Length of the command, in m/s and rad/s, above which the robot walks.
        force_threshold: Force above which a foot is in contact, N.

    Example:
        ``{func: feet_gait, weight: 0.5, params: {sensor: contacts, period_s: 0.5,
        offsets: {FL_foot|RR_foot: 0, FR_foot|RL_foot: 0.5}, command_name: velocity}}``
    """

    def __init__(
        self,
        env: TermContext,
        sensor: ContactOf,
        period_s: Positive,
        offsets: PerJoint,
        height: Positive = 0.06,
        width: Positive = 0.035,
        rest_height: NonNegative = 0.02,
        command_name: VelocityCommand | None = None,
        min_command: NonNegative = 0.1,
        force_threshold: NonNegative = 1.0,
    ) -> None:
        if isinstance(offsets, list) and len(offsets) != len(sensor.names):
            feet = ", ".join(sensor.names)
            message = f"{len(offsets)} offsets for {len(sensor.names)} feet: {feet}"
            raise ConfigError([Problem("offsets", message)])
        self._env = env
        self._sensor = sensor
        phases = per_joint(offsets, sensor.names, "offsets", "foot", sensor.plan.named_by)
        self._phases: Floats = env.arrays.put(np.tile(phases, (env.num_envs, 1)))
        self._cycles_per_step = env.step_dt / period_s
        self._height = height
        self._width = width
        self._rest_height = rest_height
        self._command = command_name
        self._min_command = min_command
        self._least_squared_force = force_threshold * force_threshold
        self._has_terrain = env.sim.scene.terrain is not None

    def __call__(self) -> Floats:
        """(N,)."""
        cycles = self._env.read_elapsed_steps() * self._cycles_per_step
        swing = np.sin(2.0 * np.pi * (cycles[:, None] + self._phases))
        if self._command is not None:
            is_walking = norm(self._command()) > self._min_command
            swing = np.where(is_walking[:, None], swing, 0.0)
        error = (self._foot_heights() - self._rest_height - self._height * swing) / self._width
        in_swing = np.exp(-error * error)
        is_touched = squares(self._sensor.read_force()) > self._least_squared_force
        in_stance = is_touched.astype(np.float64)
        return mean(np.where(swing > _SWING_EDGE, in_swing, in_stance))

    def _foot_heights(self) -> Floats:
        """(N, n) m: heights of the origins of the links above the ground or the terrain."""
        engine = self._env.sim.engine
        origins = self._sensor.frames.positions(engine)
        heights = origins[..., 2]
        if not self._has_terrain:
            return heights
        # Few scenes have a terrain.
        from embodichain.lab.sim.reads.height_field import GroundHeights

        ground, _ = GroundHeights.of(engine).read(origins[..., 0], origins[..., 1])
        return heights - ground
