"""`arrows_of`: commands as arrows in pictures for people.

A velocity is an arrow in the plane above the body that is to move so, and one along the vertical
for the turning rate, which points down where the body turns clockwise; both are green while the
body moves as commanded. A pose is three arrows, red, green and blue.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.commands import ShownCommand
from embodichain.lab.sim.drawing.overlays import Arrows
from embodichain.lab.sim.drawing.views import DrawnState
from embodichain.utils.math import quat_to_matrix

__all__ = ["arrows_of", "height_above"]

F64 = NDArray[np.float64]

_METRES_PER_SPEED = 0.3
"""Length of the arrow in the plane for each m/s."""
_METRES_PER_RATE = 0.12
"""Length of the vertical arrow for each rad/s."""
_SLOWEST = 0.02
"""Speed, m/s or rad/s, below which there is no arrow."""
_RADIUS = 0.012
"""Metres, of the shafts."""
_ABOVE = 0.06
"""Metres between the top of the robot and the arrows."""
_AXIS = 0.12
"""Metres: length of the arrows of a pose."""
_ALPHA = 0.9
_ORANGE = (0.95, 0.45, 0.1)
_GREEN = (0.15, 0.75, 0.3)
_AXIS_COLORS = ((0.9, 0.2, 0.2), (0.2, 0.75, 0.25), (0.2, 0.4, 1.0))


def arrows_of(command: ShownCommand, state: DrawnState) -> list[Arrows]:
    """The arrows of a command in a state."""
    values = np.asarray(command.values, np.float64)
    is_known = np.isfinite(values.sum(axis=1))
    values = np.where(is_known[:, None], values, 0.0)
    origins = np.asarray(state.derived("xpos")).reshape(state.num_envs, -1, 3)[:, command.body]
    axes = np.asarray(state.derived("xmat")).reshape(state.num_envs, -1, 3, 3)[:, command.body]
    if command.kind == "pose":
        return _pose_arrows(values, origins, axes, is_known)
    return _velocity_arrows(command, values, origins, axes, state)


def _pose_arrows(poses: F64, origins: F64, axes: F64, is_known: NDArray[np.bool_]) -> list[Arrows]:
    starts = origins + (axes @ poses[:, :3, None])[..., 0]
    turned = axes @ quat_to_matrix(poses[:, 3:])
    return [
        Arrows(starts, _AXIS * turned[:, :, axis], 0.5 * _RADIUS, _colors(is_known, color))
        for axis, color in enumerate(_AXIS_COLORS)
    ]


def _velocity_arrows(
    command: ShownCommand, values: F64, origins: F64, axes: F64, state: DrawnState
) -> list[Arrows]:
    heading = np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
    cos = np.cos(heading)
    sin = np.sin(heading)
    forward = values[:, 0]
    left = values[:, 1]
    turning = values[:, 2]
    zero = np.zeros_like(heading)
    motion = np.stack([cos * forward - sin * left, sin * forward + cos * left, zero], axis=1)
    rotation = np.stack([zero, zero, turning], axis=1)
    starts = origins.copy()
    starts[:, 2] += command.height + _ABOVE
    rotation_starts = starts.copy()
    # An arrow that points down ends where the others begin: above the robot, not in it.
    rotation_starts[:, 2] += _METRES_PER_RATE * np.maximum(-turning, 0.0)
    is_followed = _is_followed(command, motion[:, :2], turning, state)
    color = np.where(is_followed[:, None], _GREEN, _ORANGE)
    return [
        Arrows(
            starts,
            _METRES_PER_SPEED * motion,
            _RADIUS,
            _colors(np.hypot(forward, left) > _SLOWEST, color),
        ),
        Arrows(
            rotation_starts,
            _METRES_PER_RATE * rotation,
            _RADIUS,
            _colors(np.abs(turning) > _SLOWEST, color),
        ),
    ]


def _is_followed(
    command: ShownCommand, motion: F64, turning: F64, state: DrawnState
) -> NDArray[np.bool_]:
    """(N,) whether a body that floats moves as commanded; False of other bodies."""
    model = state.model
    joint = int(model.body_jntadr[command.body])
    tolerance = command.tolerance
    is_floating = joint >= 0 and model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_FREE)
    if tolerance is None or not is_floating:
        return np.zeros(len(motion), bool)
    start = int(model.jnt_dofadr[joint])
    velocity = np.asarray(state.state("qvel"))[:, start : start + 6]
    errors = np.linalg.norm(velocity[:, :2] - motion, axis=1)
    is_followed: NDArray[np.bool_] = errors < tolerance.linear
    if tolerance.angular is not None:
        # MuJoCo has the angular velocity of a free joint in the axes of its body.
        xmat = np.asarray(state.derived("xmat")).reshape(state.num_envs, -1, 3, 3)
        vertical = xmat[:, command.body, 2]
        rates = (vertical * velocity[:, 3:]).sum(axis=1)
        is_followed &= np.abs(rates - turning) < tolerance.angular
    return is_followed


def height_above(model: mujoco.MjModel, body: int) -> float:
    """Metres from a body's origin to the top of its mechanism at the model's `qpos0`.

    Args:
        model: The compiled scene.
        body: Id of a body; all that hangs on its root counts.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = model.body_rootid[body]
    geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == root)
    if root == 0 or not len(geoms):
        return 0.0
    upwards = data.geom_xmat[geoms, 6:9]  # the vertical in the axes of each geom
    middles = data.geom_xpos[geoms, 2] + (upwards * model.geom_aabb[geoms, :3]).sum(axis=1)
    tops = middles + (np.abs(upwards) * model.geom_aabb[geoms, 3:]).sum(axis=1)
    return max(0.0, float(tops.max() - data.xpos[body, 2]))


def _colors(shown: NDArray[np.bool_], color: Any) -> F64:
    """(N, 4) RGBA of one colour or of N."""
    colors = np.zeros((len(shown), 4))
    colors[:, :3] = color
    colors[:, 3] = np.where(shown, _ALPHA, 0.0)
    return colors
