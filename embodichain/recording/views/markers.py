"""Commands: their values, and those drawn as `/env_I/markers`.

A commanded pose is drawn as axes, a commanded velocity as arrows. Goals that are bodies are in the
scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.views.messages import Color, SceneUpdate, set_time
from embodichain.recording.views.motion import frame_names
from embodichain.utils.math import quat_multiply

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["Commands"]

AXIS_LENGTH = 0.15
METRES_PER_SPEED = 0.5
"""Length of an arrow in metres for each m/s or rad/s."""
ABOVE = 0.25
"""Height of a velocity's arrow above the body's origin, metres."""
_RED, _GREEN, _BLUE = (
    Color(r=r, g=g, b=b, a=1.0) for r, g, b in ((0.9, 0.2, 0.2), (0.2, 0.8, 0.2), (0.2, 0.4, 1.0))
)
_S = math.sqrt(0.5)
_ALONG = np.array([[1.0, 0.0, 0.0, 0.0], [_S, 0.0, 0.0, _S], [_S, 0.0, -_S, 0.0]])
"""Rotations of the x axis, along which arrows point, to each axis; wxyz."""


class Commands:
    """The commands of an environment.

    Args:
        env: The environment; it may have no commands.
    """

    def __init__(self, env: ObservedEnv) -> None:
        manager = getattr(env, "command_manager", None)  # environments of others may have none
        terms = {} if manager is None else dict(manager.terms)
        self._commands: dict[str, Any] = {name: term.instance for name, term in terms.items()}
        self._drawn = {n: term for n, term in self._commands.items() if term.marker is not None}

    @property
    def drawn(self) -> bool:
        """Whether any command has a marker."""
        return bool(self._drawn)

    def scalars(self) -> list[tuple[list[str], F64]]:
        """Names of the columns of each command, and its values, (N, columns): live."""
        found = []
        for name, command in self._commands.items():
            values = command.values
            labels = command.names or map(str, range(values.shape[1]))
            found.append(([f"{name}_{label}" for label in labels], values))
        return found

    def update(self, time_ns: int, env_id: int, data: mujoco.MjData) -> bytes:
        """Return the serialized `SceneUpdate` of an environment's drawn commands.

        Args:
            time_ns: Its time.
            env_id: The environment.
            data: Its kinematics.
        """
        update, frames = SceneUpdate(), frame_names(data.model, env_id)
        for name, command in self._drawn.items():
            kind, body = command.marker.kind, int(command.marker.body)
            entity = update.entities.add(id=f"env_{env_id}/commands/{name}")
            set_time(entity.timestamp, time_ns)
            entity.frame_locked = kind == "pose"  # it moves with the body
            entity.frame_id = frames[body if kind == "pose" else 0]
            values = command.values[env_id]
            if kind == "pose":
                _add_axes(entity.arrows, values)
            else:
                _add_velocity(entity.arrows, values.tolist(), data.xpos[body], data.xquat[body])
        encoded: bytes = update.SerializeToString()
        return encoded


def _add_axes(arrows: Any, pose: F64) -> None:
    """Add the axes of a frame: position and quaternion wxyz."""
    quats = quat_multiply(pose[3:], _ALONG)
    for quat, color in zip(quats.tolist(), (_RED, _GREEN, _BLUE), strict=True):
        _add_arrow(arrows, pose[:3].tolist(), quat, AXIS_LENGTH, color)


def _add_velocity(arrows: Any, command: Sequence[float], pos: F64, quat: F64) -> None:
    """Add an arrow in the direction of motion in the plane, and one along z for the rotation.

    Args:
        arrows: Where to add them.
        command: Velocity forward, to the left (m/s), and about z (rad/s).
        pos: (3,) position of the body.
        quat: (4,) its rotation, wxyz.
    """
    forward, left, turn = command
    (px, py, pz), (w, x, y, z) = pos.tolist(), quat.tolist()
    origin = px, py, pz + ABOVE
    speed = math.hypot(forward, left)
    if speed:
        ahead, aside = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)  # the body's x axis
        toward, beside = ahead * forward - aside * left, ahead * left + aside * forward
        half = 0.5 * math.atan2(beside, toward)
        rotation = math.cos(half), 0.0, 0.0, math.sin(half)
        _add_arrow(arrows, origin, rotation, METRES_PER_SPEED * speed, _GREEN)
    if turn:
        rotation = _S, 0.0, math.copysign(_S, -turn), 0.0
        _add_arrow(arrows, origin, rotation, METRES_PER_SPEED * abs(turn), _BLUE)


def _add_arrow(
    arrows: Any, origin: Sequence[float], quat: Sequence[float], length: float, color: Color
) -> None:
    head = min(0.3 * length, 0.06)
    arrow = arrows.add(
        shaft_length=length - head,
        shaft_diameter=0.015,
        head_length=head,
        head_diameter=0.035,
        color=color,
    )
    position, orientation = arrow.pose.position, arrow.pose.orientation
    position.x, position.y, position.z = origin
    orientation.w, orientation.x, orientation.y, orientation.z = quat
