"""Goals that are no bodies, drawn: a commanded pose as axes, a commanded velocity as an arrow.

Goals that are bodies need nothing here: they are in the scene.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import accumulate, count, pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.foxglove.frames import frame_names
from embodichain.recording.foxglove.messages import (
    ArrowPrimitive,
    Color,
    Pose,
    Quaternion,
    SceneUpdate,
    Vector3,
)
from embodichain.recording.foxglove.template import STAMP, Template, mark
from embodichain.recording.foxglove.view_spec import MarkerSpec
from embodichain.utils.math import quat_multiply

__all__ = ["Colors", "Markers"]

AXIS_LENGTH = 0.15
METRES_PER_SPEED = 0.5
"""Length of an arrow in metres for each m/s or rad/s."""
ABOVE = 0.25
"""Metres that a velocity's arrow stands above the body's origin, to be seen."""
_RED, _GREEN, _BLUE = (0.9, 0.2, 0.2), (0.2, 0.8, 0.2), (0.2, 0.4, 1.0)
_S = math.sqrt(0.5)
_ALONG = np.array([[1.0, 0.0, 0.0, 0.0], [_S, 0.0, 0.0, _S], [_S, 0.0, -_S, 0.0]])
"""Turns of the x axis, along which arrows point, to each axis; wxyz."""
_TO_AXES = quat_multiply(np.eye(4)[:, None], _ALONG).reshape(4, 12)
"""A quaternion times this is its product with each of them: the product is linear."""

Color3 = tuple[float, float, float]
Arrow = tuple[Color3, list[float]]
"""A colour, and x y z, the turn of the x axis as x y z w, the shaft's and the head's length."""

Colors = tuple[tuple[Color3, ...], ...]
"""Of the arrows of each marker, of each environment: those of no length are left out."""


class Markers:
    """What is drawn of commands.

    Args:
        model: The model; only names are read.
        env_ids: (n,) environments that are viewed.
        specs: The commands that are drawn.
        datas: Each environment's data, where `mj_kinematics` leaves poses.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        env_ids: Sequence[int],
        specs: Sequence[MarkerSpec],
        datas: Sequence[mujoco.MjData],
    ) -> None:
        self._specs, self._datas = specs, datas
        self._frames = [frame_names(model, i) for i in env_ids]
        self._templates: dict[Colors, tuple[Template, list[slice]]] = {}

    def __bool__(self) -> bool:
        """Whether there is anything to draw."""
        return bool(self._specs)

    def encode(self, time_ns: int, commands: Sequence[F64]) -> list[bytes]:
        """`SceneUpdate` of each viewed environment, as bytes; after `mj_kinematics`.

        Args:
            time_ns: The moment.
            commands: Values of the drawn commands, (n, K) each.
        """
        colors, numbers = self.drawn(commands)
        template, places = self._template_of(colors)
        filled = template.fill(np.array(numbers), time_ns)
        return [filled[place] for place in places]

    def table(
        self, times: Sequence[int], colors: Colors, numbers: Sequence[Sequence[float]]
    ) -> list[NDArray[np.uint8]]:
        """(L, bytes) messages of each environment at (L,) moments in ns.

        Args:
            times: The moments.
            colors: What is `drawn`, the same at all of them.
            numbers: Of what is drawn at each moment.
        """
        template, places = self._template_of(colors)
        filled = template.table(np.array(numbers), times)
        return [filled[:, place] for place in places]

    def drawn(self, commands: Sequence[F64]) -> tuple[Colors, list[float]]:
        """The colours of what is drawn where bodies are now, and its numbers."""
        numbers: list[float] = []
        colors: list[tuple[Color3, ...]] = []
        values = [command.tolist() for command in commands]
        for index, data in enumerate(self._datas):
            for marker, of_all in zip(self._specs, values, strict=True):
                if marker.kind == "pose":
                    arrows = _axes(of_all[index])
                else:
                    arrows = _velocity(
                        of_all[index], data.xpos[marker.body], data.xquat[marker.body]
                    )
                colors.append(tuple([color for color, _ in arrows]))
                for _, arrow in arrows:
                    numbers += arrow
        return tuple(colors), numbers

    def _template_of(self, colors: Colors) -> tuple[Template, list[slice]]:
        found = self._templates.get(colors)
        if found is None:
            if len(self._templates) > _MOST_TEMPLATES:
                self._templates.clear()
            found = self._templates[colors] = self._template(colors)
        return found

    def _template(self, colors: Colors) -> tuple[Template, list[slice]]:
        """The messages of all environments with arrows of these colours, and where each is."""
        numbers, shown, messages = count(), iter(colors), list[bytes]()
        for frames in self._frames:
            update = SceneUpdate()
            for marker in self._specs:
                entity = update.entities.add(id=f"{frames[0]}/commands/{marker.name}")
                entity.timestamp.CopyFrom(STAMP)
                entity.frame_locked = marker.kind == "pose"
                entity.frame_id = frames[marker.body if marker.kind == "pose" else 0]
                entity.arrows.extend(_arrow(color, numbers) for color in next(shown))
            messages.append(update.SerializeToString())
        ends = [0, *accumulate(map(len, messages))]
        places = [slice(begin, end) for begin, end in pairwise(ends)]
        return Template(b"".join(messages), next(numbers)), places


_NUMBERS = 9
"""Of an arrow, which change."""
_MOST_TEMPLATES = 64
"""That are kept: environments whose commands are zero now and then have many."""


def _arrow(color: Color3, numbers: Iterator[int]) -> ArrowPrimitive:
    """An arrow with marks for its numbers, in the order of `Arrow`."""
    x, y, z, qx, qy, qz, qw, shaft, head = (mark(next(numbers)) for _ in range(_NUMBERS))
    r, g, b = color
    return ArrowPrimitive(
        pose=Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw)),
        shaft_length=shaft,
        shaft_diameter=0.015,
        head_length=head,
        head_diameter=0.035,
        color=Color(r=r, g=g, b=b, a=1.0),
    )


def _axes(pose: Sequence[float]) -> list[Arrow]:
    """The axes of a frame: red, green, blue."""
    start = pose[:3]
    turned = (np.array(pose[3:]) @ _TO_AXES).reshape(3, 4).tolist()
    lengths = _lengths(AXIS_LENGTH)
    return [
        (color, [*start, x, y, z, w, *lengths])
        for (w, x, y, z), color in zip(turned, (_RED, _GREEN, _BLUE), strict=True)
    ]


def _velocity(command: Sequence[float], pos: F64, quat: F64) -> list[Arrow]:
    """An arrow where it should go, in the plane, and one along z as it should turn."""
    w, x, y, z = quat.tolist()
    forward, left, turn = command
    heading = math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    start_x, start_y, height = pos.tolist()
    start = start_x, start_y, height + ABOVE
    speed = math.hypot(forward, left)
    arrows: list[Arrow] = []
    if speed:
        half = (heading + math.atan2(left, forward)) / 2
        lengths = _lengths(METRES_PER_SPEED * speed)
        arrows.append((_GREEN, [*start, 0.0, 0.0, math.sin(half), math.cos(half), *lengths]))
    if turn:
        up = -_S if turn > 0 else _S
        lengths = _lengths(METRES_PER_SPEED * abs(turn))
        arrows.append((_BLUE, [*start, 0.0, up, 0.0, _S, *lengths]))
    return arrows


def _lengths(length: float) -> tuple[float, float]:
    """Of an arrow's shaft and head."""
    head = min(0.3 * length, 0.06)
    return length - head, head
