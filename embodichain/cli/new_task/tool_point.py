"""`find_tool_point`: the frame of a robot's tool whose z axis points out of its hand.

Experts approach along that axis. A file's own site or link is taken where it points so; else the
frame is turned, or put between the ends of the fingers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.new_reach import ToolFrame

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mujoco
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

__all__ = [
    "Gripping",
    "ToolPoint",
    "body_of",
    "corners_of",
    "find_tool_point",
    "gap_between_fingers",
    "subtree_of",
]

_ALONG = 0.94
"""Cosine of 20 degrees: an axis as near to a direction points there."""
_ROLLING = 0.5
"""Cosine of 60 degrees: a last joint whose axis is as near to the fingers rolls the hand."""
_FIRST_MOTION = 0.1
"""Share of its way by which a gripper is opened, to see along which line its fingers part."""
_BETWEEN = 0.015
"""Distance in metres across the fingers at which a frame is between them."""
_BEHIND_TIPS = 0.06
"""Distance in metres behind the ends of the fingers at which a frame is still at them."""
_BEYOND_TIPS = 0.02
"""Likewise, beyond them."""
_GRASP_DEPTH = 0.015
"""Distance in metres from the ends of the fingers to what they grasp."""
_SHORTEST_HAND = 0.01
"""Metres: a tool that is nearer to its last joint shows no direction."""


@dataclass(frozen=True)
class Gripping:
    """A gripper that opens and closes, for `find_tool_point`.

    Attributes:
        left: The body of a finger.
        right: That of the other one, or the hand on which a single jaw closes.
        open: Joint -> position when open, rad or m.
        close: Likewise, when closed.
    """

    left: str
    right: str
    open: dict[str, float]
    close: dict[str, float]


@dataclass(frozen=True, eq=False)
class ToolPoint:
    """Where a robot's tool is.

    Attributes:
        frame: The link or site that carries it.
        matrix: (4, 4) its pose there, m; None if it is the frame itself.
        why: How it was found.
    """

    frame: ToolFrame
    matrix: F64 | None
    why: str


def find_tool_point(
    model: mujoco.MjModel, data: mujoco.MjData, named: ToolFrame, gripping: Gripping | None
) -> ToolPoint:
    """Find the tool's point and axis.

    Args:
        model: The robot.
        data: A state of it.
        named: What is called as tools are, or ends the longest chain.
        gripping: The gripper, if there is one.
    """
    if gripping is None:
        return _without_fingers(model, data, named)
    import mujoco

    opened = _state(model, data, gripping.open)
    closed = _state(model, data, gripping.close)
    begun = {
        name: value + _FIRST_MOTION * (gripping.open[name] - value)
        for name, value in gripping.close.items()
    }
    line = _closing_line(_state(model, data, begun), closed, gripping)
    bodies = [model.body(name).id for name in (gripping.left, gripping.right)]
    hand = _common_body(model, bodies)
    fingers = [subtree_of(model, body) for body in bodies if body != hand]
    corners = [corners_of(model, closed, finger) for finger in fingers]
    middle = np.mean([points.mean(axis=0) for points in corners], axis=0)
    out = middle - opened.xpos[hand]
    roll = _last_axis(model, opened, hand)
    if abs(float(roll @ out)) > _ROLLING * float(np.linalg.norm(out)):
        out = roll * np.sign(roll @ out)
    else:
        out -= line * (out @ line)
    out = _near_axis(out / np.linalg.norm(out), opened.xmat[hand].reshape(3, 3))
    line = line - out * (line @ out)
    line /= np.linalg.norm(line)
    tip = min(float((points @ out).max()) for points in corners)

    tool_pos, tool_axes = _pose(opened, named)
    sideways = tool_pos - middle
    sideways = sideways - out * (sideways @ out)
    depth = tip - float(tool_pos @ out)
    is_between = len(fingers) == 1 or abs(float(sideways @ line)) < _BETWEEN
    is_at_tips = -_BEYOND_TIPS <= depth <= _BEHIND_TIPS
    if is_between and is_at_tips and float(tool_axes[:, 2] @ out) > _ALONG:
        return ToolPoint(named, None, "its z axis points out of the fingers")
    if is_between and is_at_tips:
        pos = tool_pos
        why = f"{named.name}, turned until its z axis points out of the fingers"
    else:
        pos = middle + out * (tip - _GRASP_DEPTH - float(middle @ out))
        if len(fingers) == 1:  # a jaw touches the hand where its end is when it is closed
            far = corners[0] @ out > tip - _GRASP_DEPTH
            pos = corners[0][far].mean(axis=0) - out * _GRASP_DEPTH
        why = f"between the fingers, {100 * _GRASP_DEPTH:g} cm from their ends"
    axes = np.stack([line, np.cross(out, line), out], axis=1)
    mujoco.mj_kinematics(model, opened)
    hand_frame = ToolFrame("link", model.body(hand).name)
    return ToolPoint(hand_frame, _relative(opened, hand_frame, pos, axes), why)


def gap_between_fingers(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    point: F64,
    line: F64,
    fingers: Sequence[str],
) -> float:
    """Distance in metres between the surfaces of two fingers, along a line through a point.

    Args:
        model: The robot.
        data: A state in which the gripper is open.
        point: (3,) a place between the fingers, m.
        line: (3,) the direction in which the second finger opens.
        fingers: Their bodies, two.

    Returns:
        The distance; 0 if the line does not meet both.
    """
    import mujoco

    left, right = (set(subtree_of(model, model.body(name).id)) for name in fingers)
    left -= right  # a hand carries the jaw that closes on it
    gap = 0.0
    geom = np.zeros(1, np.int32)
    for direction, bodies in ((line, right), (-line, left)):
        start = point.copy()
        while True:
            distance = mujoco.mj_ray(model, data, start, direction, None, 1, -1, geom)
            if distance < 0:
                return 0.0
            start = start + direction * distance
            if int(model.geom_bodyid[geom[0]]) in bodies:
                break
            start = start + direction * 1e-4
        gap += float(np.linalg.norm(start - point))
    return gap


def body_of(model: mujoco.MjModel, frame: ToolFrame) -> int:
    """MuJoCo's id of the body that carries a frame."""
    if frame.kind == "site":
        return int(model.site(frame.name).bodyid[0])
    return int(model.body(frame.name).id)


def _without_fingers(model: mujoco.MjModel, data: mujoco.MjData, named: ToolFrame) -> ToolPoint:
    """The tool of an arm whose hand has no fingers: z points away from the last joint."""
    pos, axes = _pose(data, named)
    joints = _joints_of_chain(model, body_of(model, named))
    if not joints:
        return ToolPoint(named, None, "as it is in the file")
    out = pos - data.xanchor[joints[-1]]
    if float(np.linalg.norm(out)) < _SHORTEST_HAND:
        out = data.xaxis[joints[-1]].copy()
        if len(joints) > 1:
            out *= np.sign(out @ (pos - data.xanchor[joints[-2]])) or 1.0
    out = out / np.linalg.norm(out)
    cosines = axes.T @ out
    if cosines[2] > np.sqrt(0.5):
        return ToolPoint(named, None, "its z axis points away from the last joint")
    out = _near_axis(out, axes)
    across = axes[:, int(np.argmin(np.abs(axes.T @ out)))]
    across = across - out * (across @ out)
    across /= np.linalg.norm(across)
    turned = np.stack([across, np.cross(out, across), out], axis=1)
    matrix = _relative(data, named, pos, turned)
    why = f"{named.name}, turned until its z axis points away from the last joint"
    return ToolPoint(named, matrix, why)


def _joints_of_chain(model: mujoco.MjModel, body: int) -> list[int]:
    """MuJoCo's ids of the joints between the world and a body, from the world on."""
    joints: list[int] = []
    while body:
        first = int(model.body_jntadr[body])
        joints[:0] = range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return joints


def _last_axis(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> F64:
    """(3,) the axis of the last joint that moves a body; zero without one."""
    joints = _joints_of_chain(model, body)
    return data.xaxis[joints[-1]].copy() if joints else np.zeros(3)


def _state(
    model: mujoco.MjModel, data: mujoco.MjData, positions: dict[str, float]
) -> mujoco.MjData:
    """The state with some joints elsewhere, as far as their limits allow."""
    import mujoco

    state = mujoco.MjData(model)
    state.qpos[:] = data.qpos
    for name, value in positions.items():
        joint = model.joint(name)
        if joint.limited:
            value = min(max(value, joint.range[0]), joint.range[1])
        state.joint(name).qpos = value
    mujoco.mj_kinematics(model, state)
    mujoco.mj_comPos(model, state)
    return state


def _closing_line(opened: mujoco.MjData, closed: mujoco.MjData, gripping: Gripping) -> F64:
    """(3,) the direction in which the right finger moves from the left one, to open."""
    width_open = opened.body(gripping.right).xipos - opened.body(gripping.left).xipos
    width_closed = closed.body(gripping.right).xipos - closed.body(gripping.left).xipos
    line: F64 = width_open - width_closed
    length = float(np.linalg.norm(line))
    if length < 1e-6:
        line = width_open
        length = float(np.linalg.norm(line))
    return line / length


def _common_body(model: mujoco.MjModel, bodies: Sequence[int]) -> int:
    """The nearest body that carries all of some bodies, which may be one of them."""
    chains = [_chain(model, body) for body in bodies]
    return next(body for body in chains[0] if all(body in chain for chain in chains))


def _chain(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and those that carry it."""
    chain = [body]
    while body:
        body = int(model.body_parentid[body])
        chain.append(body)
    return chain


def subtree_of(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and those that it carries."""
    bodies = [body]
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in bodies:
            bodies.append(other)
    return bodies


def corners_of(model: mujoco.MjModel, data: mujoco.MjData, bodies: Sequence[int]) -> F64:
    """(n, 3) corners of the boxes around the shapes of bodies, m; their origins without any.

    Shapes that collide count, where there are some.
    """
    import itertools

    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    is_solid = (model.geom_contype[geoms] != 0) | (model.geom_conaffinity[geoms] != 0)
    if is_solid.any():
        geoms = geoms[is_solid]
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    points = []
    for geom in geoms:
        middle, half_size = np.split(model.geom_aabb[geom], 2)
        local = middle + signs * half_size
        points.append(data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T)
    if not points:
        return data.xpos[list(bodies)].copy()
    return np.concatenate(points)


def _near_axis(direction: F64, axes: F64) -> F64:
    """The axis of a frame, to either side, that is within 20 degrees of a direction, or that."""
    cosines = axes.T @ direction
    nearest = int(np.argmax(np.abs(cosines)))
    if abs(float(cosines[nearest])) < _ALONG:
        return direction
    return axes[:, nearest] * np.sign(cosines[nearest])


def _pose(data: mujoco.MjData, frame: ToolFrame) -> tuple[F64, F64]:
    """Position (3,) and axes (3, 3) of a frame in the world."""
    element = data.site(frame.name) if frame.kind == "site" else data.body(frame.name)
    return element.xpos.copy(), element.xmat.reshape(3, 3).copy()


def _relative(data: mujoco.MjData, frame: ToolFrame, pos: F64, axes: F64) -> F64:
    """(4, 4) a pose in a frame."""
    frame_pos, frame_axes = _pose(data, frame)
    matrix = np.eye(4)
    matrix[:3, :3] = frame_axes.T @ axes
    matrix[:3, 3] = frame_axes.T @ (pos - frame_pos)
    return matrix
