"""Where links, sites and geoms of one file are, before the scene exists."""

from __future__ import annotations

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import FrameKind
from embodichain.lab.sim.compiler.robot.files.robot_files import compile_quietly
from embodichain.utils.math import quat_multiply, quat_rotate

__all__ = ["local_pose", "on_frame"]

_UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


def on_frame(
    spec: mujoco.MjSpec, kind: FrameKind, name: str, pos: F64, quat: F64
) -> tuple[str, F64, F64]:
    """The body that carries a frame, and in that body's frame a pose that is given in the frame's.

    Args:
        spec: The file.
        kind: The kind of the frame.
        name: The frame.
        pos: (3,) metres in the frame.
        quat: (4,) wxyz in the frame.
    """
    if kind == "link":
        return name, pos, quat
    # Where a geom is follows from its mesh, or from two points: compiled values are right.
    body, frame_pos, frame_quat = local_pose(compile_quietly(spec), kind, name)
    pos_in_body = frame_pos + quat_rotate(frame_quat, pos)
    quat_in_body = np.asarray(quat_multiply(frame_quat, quat))
    return body, pos_in_body, quat_in_body


def local_pose(model: mujoco.MjModel, kind: FrameKind, name: str) -> tuple[str, F64, F64]:
    """The body that carries a frame, and the frame's position (3,) and orientation (4,) in it."""
    if kind == "link":
        return name, np.zeros(3), _UNTURNED.copy()
    frame = model.site(name) if kind == "site" else model.geom(name)
    return model.body(int(frame.bodyid[0])).name, frame.pos.copy(), frame.quat.copy()
