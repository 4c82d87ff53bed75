"""Goals that are no bodies, drawn: a commanded pose as axes, a commanded velocity as an arrow.

Goals that are bodies need nothing here: they are in the scene.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.foxglove.frames import frame_names
from embodichain.recording.foxglove.messages import (
    ArrowPrimitive,
    Color,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    Vector3,
    timestamp,
)
from embodichain.recording.foxglove.view_spec import MarkerSpec

__all__ = ["Markers", "Taken"]

Taken = Mapping[str, F64]
"""Values of commands, (n, K) each, of the viewed environments."""

AXIS_LENGTH = 0.15
METRES_PER_SPEED = 0.5
"""Length of an arrow in metres for each m/s or rad/s."""
ABOVE = 0.25
"""Metres that a velocity's arrow stands above the body's origin, to be seen."""
_RED, _GREEN, _BLUE = (0.9, 0.2, 0.2), (0.2, 0.8, 0.2), (0.2, 0.4, 1.0)
_S = math.sqrt(0.5)
_ALONG = {"x": (1.0, 0.0, 0.0, 0.0), "y": (_S, 0.0, 0.0, _S), "z": (_S, 0.0, -_S, 0.0)}
"""Turns of the x axis, along which arrows point, to each axis; wxyz."""


class Markers:
    """What is drawn of commands.

    Args:
        model: The model; only names are read.
        env_ids: (n,) environments that are viewed.
        specs: The commands that are drawn.
    """

    def __init__(
        self, model: mujoco.MjModel, env_ids: Sequence[int], specs: Sequence[MarkerSpec]
    ) -> None:
        self._specs = specs
        self._frames = [frame_names(model, i) for i in env_ids]

    def __bool__(self) -> bool:
        """Whether there is anything to draw."""
        return bool(self._specs)

    def encode(self, time_ns: int, index: int, data: mujoco.MjData, taken: Taken) -> bytes:
        """`SceneUpdate` of the index-th viewed environment, as bytes; after `mj_kinematics`."""
        frames = self._frames[index]
        update = SceneUpdate()
        for marker in self._specs:
            entity = update.entities.add(id=f"{frames[0]}/commands/{marker.name}")
            entity.timestamp.CopyFrom(timestamp(time_ns))
            values = taken[marker.name][index].tolist()
            if marker.kind == "pose":
                entity.frame_id, entity.frame_locked = frames[marker.body], True
                _axes(entity, values)
            else:
                entity.frame_id = frames[0]
                _velocity(entity, values, data.xpos[marker.body], data.xquat[marker.body])
        encoded: bytes = update.SerializeToString()
        return encoded


def _axes(entity: SceneEntity, pose: Sequence[float]) -> None:
    """The axes of a frame: red, green, blue."""
    quat = np.array(pose[3:])
    for turn, color in zip(_ALONG.values(), (_RED, _GREEN, _BLUE), strict=True):
        turned = np.empty(4)
        mujoco.mju_mulQuat(turned, quat, np.array(turn))
        _arrow(entity, pose[:3], turned.tolist(), AXIS_LENGTH, color)


def _velocity(entity: SceneEntity, command: Sequence[float], pos: F64, quat: F64) -> None:
    """An arrow where it should go, in the plane, and one along z as it should turn."""
    w, x, y, z = quat.tolist()
    forward, left, turn = command
    heading = math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    start = (*pos[:2].tolist(), float(pos[2]) + ABOVE)
    speed = math.hypot(forward, left)
    if speed:
        half = (heading + math.atan2(left, forward)) / 2
        length = METRES_PER_SPEED * speed
        _arrow(entity, start, (math.cos(half), 0.0, 0.0, math.sin(half)), length, _GREEN)
    if turn:
        up = _ALONG["z"] if turn > 0 else (_S, 0.0, _S, 0.0)
        _arrow(entity, start, up, METRES_PER_SPEED * abs(turn), _BLUE)


def _arrow(
    entity: Any,
    start: Sequence[float],
    quat: Sequence[float],
    length: float,
    color: tuple[float, float, float],
) -> None:
    qw, qx, qy, qz = quat
    x, y, z = start
    r, g, b = color
    head = min(0.3 * length, 0.06)
    entity.arrows.append(
        ArrowPrimitive(
            pose=Pose(
                position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw)
            ),
            shaft_length=length - head,
            shaft_diameter=0.015,
            head_length=head,
            head_diameter=0.035,
            color=Color(r=r, g=g, b=b, a=1.0),
        )
    )
