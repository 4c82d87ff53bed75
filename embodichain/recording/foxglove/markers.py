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

__all__ = ["Markers"]

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
_COLORS: dict[str, tuple[Color3, ...]] = {
    "pose": (_RED, _GREEN, _BLUE),
    "velocity": (_GREEN, _BLUE),
}
"""Of the arrows that a marker may have, by its kind."""
_NUMBERS = 9
"""Of an arrow: x y z, the turn of the x axis as x y z w, the shaft's and the head's length."""
_MOST_TEMPLATES = 64
"""That are kept: environments whose commands are zero now and then have many."""


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
        self._templates: dict[bytes, tuple[Template, list[slice]]] = {}

    def __bool__(self) -> bool:
        """Whether there is anything to draw."""
        return bool(self._specs)

    def table(
        self, stamped: NDArray[np.uint8], commands: Sequence[F64], poses: F64
    ) -> list[NDArray[np.uint8]]:
        """(L, bytes) `SceneUpdate` of each viewed environment.

        Args:
            stamped: The `stamps` of L moments.
            commands: Values of the drawn commands, (n, K) each, at all of them.
            poses: (L, n, bodies, 7) as of `Frames.poses`.
        """
        arrows, there = list[F64](), list[NDArray[np.bool_]]()
        for marker, values in zip(self._specs, commands, strict=True):
            if marker.kind == "pose":
                found = np.broadcast_to(_axes(values), (len(poses), len(values), 3, _NUMBERS))
                shown = np.ones((len(values), 3), np.bool_)
            else:
                with np.errstate(over="ignore", invalid="ignore"):  # who diverged is shown, too
                    found, shown = _velocity(values, poses[:, :, marker.body - 1])
            arrows.append(found)
            there.append(shown)
        shown = np.concatenate(there, 1)
        template, places = self._template_of(shown)
        numbers = np.concatenate(arrows, 2)[:, shown]
        filled = template.table(numbers.reshape(len(poses), -1), stamped)
        return [filled[:, place] for place in places]

    def _template_of(self, shown: NDArray[np.bool_]) -> tuple[Template, list[slice]]:
        key = shown.tobytes()
        found = self._templates.get(key)
        if found is None:
            if len(self._templates) > _MOST_TEMPLATES:
                self._templates.clear()
            found = self._templates[key] = self._template(shown)
        return found

    def _template(self, shown: NDArray[np.bool_]) -> tuple[Template, list[slice]]:
        """The messages of all environments with (n, arrows) of them, and where each is."""
        numbers, messages = count(), list[bytes]()
        for frames, of_env in zip(self._frames, shown.tolist(), strict=True):
            update, each = SceneUpdate(), iter(of_env)
            for marker in self._specs:
                entity = update.entities.add(id=f"{frames[0]}/commands/{marker.name}")
                entity.timestamp.CopyFrom(STAMP)
                entity.frame_locked = marker.kind == "pose"
                entity.frame_id = frames[marker.body if marker.kind == "pose" else 0]
                colors = [color for color in _COLORS[marker.kind] if next(each)]
                entity.arrows.extend(_arrow(color, numbers) for color in colors)
            messages.append(update.SerializeToString())
        ends = [0, *accumulate(map(len, messages))]
        places = [slice(begin, end) for begin, end in pairwise(ends)]
        return Template(b"".join(messages), next(numbers)), places


def _arrow(color: Color3, numbers: Iterator[int]) -> ArrowPrimitive:
    """An arrow with marks for its numbers, in their order."""
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


def _axes(poses: F64) -> F64:
    """(n, 3, 9) axes of n frames: red, green, blue."""
    arrows = np.empty((len(poses), 3, _NUMBERS))
    arrows[:, :, :3] = poses[:, None, :3]
    turned = (poses[:, 3:] @ _TO_AXES).reshape(-1, 3, 4)
    arrows[:, :, 3:6], arrows[:, :, 6] = turned[:, :, 1:], turned[:, :, 0]
    arrows[:, :, 7], arrows[:, :, 8] = _lengths(np.array(AXIS_LENGTH))
    return arrows


def _velocity(commands: F64, poses: F64) -> tuple[F64, NDArray[np.bool_]]:
    """Arrows where bodies should go, in the plane, and along z as they should turn.

    Args:
        commands: (n, 3) velocity forward, to the left, and about z.
        poses: (L, n, 7) of the bodies.

    Returns:
        (L, n, 2, 9), and which of them have a length, (n, 2).
    """
    forward, left, turn = commands.T
    speed = np.sqrt(forward**2 + left**2)
    w, x, y, z = np.moveaxis(poses[..., 3:], -1, 0)
    ahead, aside = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)  # of the body's x axis
    toward, beside = ahead * forward - aside * left, ahead * left + aside * forward
    length = np.sqrt(toward**2 + beside**2)
    cosine = np.divide(toward, length, np.ones_like(length), where=length > 0)
    arrows = np.zeros((*poses.shape[:2], 2, _NUMBERS))
    arrows[..., :3] = poses[:, :, None, :3]
    arrows[..., 2] += ABOVE
    # Half the angle, from its cosine.
    arrows[:, :, 0, 5] = np.copysign(np.sqrt(np.maximum(0.0, 0.5 - 0.5 * cosine)), beside)
    arrows[:, :, 0, 6] = np.sqrt(np.maximum(0.0, 0.5 + 0.5 * cosine))
    arrows[:, :, 0, 7], arrows[:, :, 0, 8] = _lengths(METRES_PER_SPEED * speed)
    arrows[:, :, 1, 4], arrows[:, :, 1, 6] = np.copysign(_S, -turn), _S
    arrows[:, :, 1, 7], arrows[:, :, 1, 8] = _lengths(METRES_PER_SPEED * np.abs(turn))
    return arrows, np.stack([speed, turn], 1) != 0


def _lengths(lengths: F64) -> tuple[F64, F64]:
    """Of arrows' shafts and heads."""
    heads = np.minimum(0.3 * lengths, 0.06)
    return lengths - heads, heads
