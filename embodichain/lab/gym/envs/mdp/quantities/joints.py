"""Quantities of joints: positions, velocities, efforts, and their excess over limits.

K is the number of picked joints. Joints without a limit never exceed it; if no picked joint has a
limit, that is an error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import (
    Command,
    Fraction,
    Joints,
    NonNegative,
    Positive,
)
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import norm, total
from embodichain.utils.arrays import contiguous
from embodichain.utils.math import wrapped

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = [
    "joint_effort",
    "joint_effort_excess",
    "joint_pos_limit_normalized",
    "joint_position",
    "joint_position_excess",
    "joint_power",
    "joint_sin_cos",
    "joint_speed",
    "joint_target_error",
    "joint_velocity",
    "joint_velocity_excess",
    "stand_still",
]


@quantity()
def joint_position(
    env: TermContext,
    of: Joints,
    relative: bool = False,
    periodic: bool = False,
    biased: bool = False,
) -> Floats:
    """(N, K) positions of the picked joints, rad or m.

    Args:
        relative: Whether the initial positions are subtracted.
        periodic: Whether positions are angles, which are wrapped to [-pi, pi).
        biased: Whether they are what encoders read, with the errors of the event `encoder_bias`.

    Example:
        ``{func: joint_position, params: {of: {uid: ur10}, relative: true}}``
    """
    qpos = of.displacement() if relative else of.qpos()
    if biased:
        qpos = qpos + of.encoder_bias()
    return wrapped(qpos) if periodic else qpos


@quantity()
def joint_velocity(env: TermContext, of: Joints) -> Floats:
    """(N, K) velocities of the picked joints, rad/s or m/s.

    Example:
        ``{func: joint_velocity, params: {of: {uid: ur10}}}``
    """
    return of.qvel()


@quantity()
def joint_speed(env: TermContext, of: Joints) -> Floats:
    """(N, K) absolute velocities of the picked joints, rad/s or m/s.

    Example:
        ``{func: joint_speed, params: {of: {uid: ur10}}}``
    """
    return np.abs(of.qvel())


@quantity()
def joint_effort(env: TermContext, of: Joints) -> Floats:
    """(N, K) efforts of the picked joints in the last physics step, N m or N.

    The sum of the efforts of drives, their damping and effort actions: Isaac Lab's applied torque.
    The damping of a joint without a drive counts as well.

    Example:
        ``{func: joint_effort, params: {of: {uid: ur10}}}``
    """
    return of.effort()


@quantity()
def joint_power(env: TermContext, of: Joints, positive_only: bool = False) -> Floats:
    """(N,) sum of |effort x qvel| over the picked joints, W: times the time step, energy.

    Efforts as in `joint_effort`, of the last physics step; velocities after it. mjlab's
    `electrical_power_cost` counts only positive power: `positive_only`.

    Args:
        positive_only: Whether negative power (braking) counts as 0.

    Example:
        ``{func: joint_power, params: {of: {uid: ur10}}}``
    """
    power = of.effort() * of.qvel()
    return total(np.maximum(power, 0.0) if positive_only else np.abs(power))


@quantity()
def joint_target_error(env: TermContext, of: Joints) -> Floats:
    """(N,) mean of |target - qpos| over the picked joints, rad or m; 0 for joints without a drive.

    Example:
        ``{func: joint_target_error, params: {of: {uid: ur10}}}``
    """
    return total(np.abs(of.target_qpos() - of.qpos())) / len(of.joint_ids)


@quantity()
def joint_position_excess(env: TermContext, of: Joints, soft_ratio: Fraction = 1.0) -> Floats:
    """(N, K) how far joints are beyond the nearer position limit, rad or m; negative within.

    Limits in MuJoCo are soft: positive values under load are possible with a `soft_ratio` of 1.

    Args:
        soft_ratio: Allowed fraction of the range, about its middle.

    Example:
        ``{func: joint_position_excess, params: {of: {uid: ur10}, soft_ratio: 0.9}}``
    """
    qpos = of.qpos()
    low, high = of.qpos_limits(soft_ratio)
    return np.maximum(low - qpos, qpos - high)


@quantity()
def joint_velocity_excess(
    env: TermContext, of: Joints, soft_ratio: Fraction = 1.0, max_velocity: Positive | None = None
) -> Floats:
    """(N, K) excess of joint speeds over a limit, rad/s or m/s; negative where they are slower.

    The limit is the smaller of the drive's `max_velocity` and the file's; physics enforces neither.

    Args:
        soft_ratio: Allowed fraction of the limit.
        max_velocity: Replaces the limit, rad/s or m/s.

    Example:
        ``{func: joint_velocity_excess, params: {of: {uid: ur10}, soft_ratio: 0.9}}``
    """
    limits = of.qvel_limits() if max_velocity is None else max_velocity
    return np.abs(of.qvel()) - limits * soft_ratio


@quantity()
def joint_effort_excess(env: TermContext, of: Joints, soft_ratio: Fraction = 1.0) -> Floats:
    """(N, K) excess of asked efforts over a limit, N m or N; negative where they are smaller.

    The effort is that which a drive, servo, motor or effort action asks for in the last physics
    step, before the limit cuts it: Isaac Lab's computed effort. The limit is the smaller of the
    drive's `max_effort` and the file's.

    Args:
        soft_ratio: Allowed fraction of the limit.

    Example:
        ``{func: joint_effort_excess, params: {of: {uid: ur10}, soft_ratio: 0.8}}``
    """
    return np.abs(of.computed_effort()) - of.effort_limits() * soft_ratio


@quantity("reward", "metric")
def stand_still(
    env: TermContext, of: Joints, command_name: Command, command_threshold: NonNegative = 0.06
) -> Floats:
    """(N,) sum of |qpos - initial qpos| where the command is nearly zero, else 0; rad or m.

    Isaac Lab's `stand_still_joint_deviation_l1`, over all columns of the command.

    Args:
        command_name: A velocity command.
        command_threshold: Euclidean norm below which the command counts as zero, in its units.

    Example:
        ``{func: stand_still, weight: -0.5, params: {of: {uid: go}, command_name: velocity}}``
    """
    deviation = total(np.abs(of.displacement()))
    return np.where(norm(command_name()) < command_threshold, deviation, 0.0)


@quantity("observation")
def joint_sin_cos(env: TermContext, of: Joints) -> Floats:
    """(N, 2 K) sines of the picked joints' positions, then their cosines.

    Example:
        ``{func: joint_sin_cos, params: {of: {uid: ur10}}}``
    """
    # Contiguous: numpy may round a strided transcendental function differently.
    qpos = contiguous(of.qpos())
    return np.concatenate([np.sin(qpos), np.cos(qpos)], axis=1)


@quantity()
def joint_pos_limit_normalized(env: TermContext, of: Joints) -> Floats:
    """(N, K) normalized positions of the picked joints: -1 at the lower limit, 1 at the upper.

    2 (q - low) / (high - low) - 1, with the limits in force, not clipped. Isaac Lab's observation
    of the same name.

    Example:
        ``{func: joint_pos_limit_normalized, params: {of: {uid: ur10}}}``

    Raises:
        ConfigError: If a joint has no limits.
    """
    low, high = of.qpos_ranges()
    return 2.0 * (of.qpos() - low) / (high - low) - 1.0
