"""Quantities of commands: the command itself, and the robot's error.

A velocity command has the columns vx, vy (m/s) and wz (rad/s). A pose command is (N, 7): x, y, z in
metres and a wxyz quaternion, in the frame of the robot's root.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import (
    Body,
    Command,
    PlanarCommand,
    PoseCommand,
    PositionCommand,
    Positive,
    VelocityCommand,
)
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import angle_between, norm
from embodichain.lab.sim.reads.body_motion import Frame
from embodichain.utils.math import quat_multiply, quat_rotate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = [
    "angular_velocity_error",
    "command",
    "follows_velocity",
    "linear_velocity_error",
    "orientation_command_error",
    "position_command_error",
]


@quantity()
def command(env: TermContext, command_name: Command) -> Floats:
    """(N, K) the command in force, in the units of the command.

    Example:
        ``{func: command, params: {command_name: velocity}}``
    """
    return command_name()


@quantity()
def linear_velocity_error(
    env: TermContext, of: Body, command_name: PlanarCommand, frame: Frame = "body"
) -> Floats:
    """(N, 2) velocity in the plane minus a commanded one, m/s.

    Args:
        frame: The axes of the velocity: those of the ``body``, of its heading (``yaw``), which are
            level, or of the environment (``world``).

    Example:
        ``{func: linear_velocity_error, params: {of: {uid: go}, command_name: velocity}}``
    """
    return of.linear_velocity(frame)[:, :2] - command_name()[:, :2]


@quantity()
def angular_velocity_error(
    env: TermContext,
    of: Body,
    command_name: VelocityCommand,
    frame: Literal["body", "world"] = "body",
) -> Floats:
    """(N,) turning rate about z minus a commanded one, rad/s.

    Args:
        frame: The z axis of the rate: that of the ``body`` or of the ``world``.

    Example:
        ``{func: angular_velocity_error, params: {of: {uid: go}, command_name: velocity}}``
    """
    return of.angular_velocity(frame)[:, 2] - command_name()[:, 2]


@quantity("reward", "metric", "termination")
def follows_velocity(
    env: TermContext,
    of: Body,
    command_name: VelocityCommand,
    linear_threshold: Positive,
    angular_threshold: Positive | None = None,
) -> NDArray[np.bool_]:
    """True where velocity in the heading frame and turning rate are close to a command.

    Args:
        linear_threshold: Largest error in the plane, m/s.
        angular_threshold: Largest error about the vertical, rad/s; None means no condition.

    Example:
        ``{func: follows_velocity, params: {of: {uid: go}, command_name: velocity,
        linear_threshold: 0.3}}``
    """
    error = of.linear_velocity("yaw")[:, :2] - command_name()[:, :2]
    is_close: NDArray[np.bool_] = norm(error) < linear_threshold
    if angular_threshold is not None:
        turning_error = of.angular_velocity()[:, 2] - command_name()[:, 2]
        is_close = is_close & (np.abs(turning_error) < angular_threshold)
    return is_close


@quantity()
def position_command_error(env: TermContext, of: Body, command_name: PositionCommand) -> Floats:
    """(N,) distance between a link and a commanded position, m. Isaac Lab's of the same name.

    Args:
        of: The robot and one link of it.

    Example:
        ``{func: position_command_error, params: {of: {uid: ur10, link_names: [ee_link]},
        command_name: pose}}``
    """
    root_pos, root_quat = of.asset.read_pose()
    target = root_pos + quat_rotate(root_quat, command_name()[:, :3])
    return norm(target - of.position())


@quantity()
def orientation_command_error(env: TermContext, of: Body, command_name: PoseCommand) -> Floats:
    """(N,) angle between a link and a commanded orientation, rad in [0, pi].

    Isaac Lab's of the same name.

    Args:
        of: The robot and one link of it.

    Example:
        ``{func: orientation_command_error, params: {of: {uid: ur10, link_names: [ee_link]},
        command_name: pose}}``
    """
    _, root_quat = of.asset.read_pose()
    target = quat_multiply(root_quat, command_name()[:, 3:7])
    return angle_between(of.orientation(), target)
