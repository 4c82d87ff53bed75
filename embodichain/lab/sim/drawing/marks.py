"""Marks of a compiled model: what pictures for people show beside the scene.

A mark is a text of the model, so the pictures of a log have it too. Nothing touches or measures it,
and cameras whose images are observations do not see it.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any
from urllib.parse import quote, unquote

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.views import DrawnState

__all__ = ["HALO", "MARK_PREFIX", "Mark", "MarkedState", "Reached", "marks_of"]

MARK_PREFIX = "mark/"
"""Begin of the names of the model's texts that are marks; the object's uid follows."""
HALO = "halo"
"""Name of an object's halo among its geoms; in the model it is invisible."""
_HALO_ALPHA = 0.35


@dataclass(frozen=True, kw_only=True)
class Reached:
    """When an object is drawn in another colour: while a point is near a point of it.

    Attributes:
        body: The body that the point is fixed on.
        pos: (3,) metres, the point in that body's frame.
        offset: (3,) metres, the point of the object, in the object's frame.
        within: Metres, the largest distance.
        color: RGB in [0, 1].
    """

    body: str
    pos: tuple[float, ...]
    offset: tuple[float, ...]
    within: float
    color: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Mark:
    """How an object is marked.

    Attributes:
        uid: The object, and its body's name.
        reached: When it has another colour.
    """

    uid: str
    reached: Reached | None

    def as_text(self) -> str:
        """The text that the model has: JSON whose quotation marks are percent-encoded.

        MJCF has a text with quotation marks in a CDATA section, which XML tools replace by plain
        text, and MuJoCo reads none.
        """
        reached = None if self.reached is None else asdict(self.reached)
        return quote(json.dumps({"reached": reached}), safe="{}[]:, ")

    @classmethod
    def of_text(cls, uid: str, text: str) -> Mark:
        """Read what `as_text` wrote."""
        reached = json.loads(unquote(text))["reached"]
        return cls(uid=uid, reached=None if reached is None else Reached(**reached))


def marks_of(model: mujoco.MjModel) -> list[Mark]:
    """The marks of a compiled model."""
    marks: list[Mark] = []
    for index in range(model.ntext):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, index) or ""
        if name.startswith(MARK_PREFIX):
            start = int(model.text_adr[index])
            length = int(model.text_size[index]) - 1  # without the final zero
            text = bytes(model.text_data)[start : start + length].decode()
            marks.append(Mark.of_text(name.removeprefix(MARK_PREFIX), text))
    return marks


class MarkedState:
    """A state whose marked objects look as they should; all else is as in the state.

    Args:
        state: The environments.
        marks: Of its model.
    """

    def __init__(self, state: DrawnState, marks: list[Mark]) -> None:
        self._state = state
        self._marks = marks

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled scene."""
        return self._state.model

    @property
    def num_envs(self) -> int:
        """N."""
        return self._state.num_envs

    def derived(self, name: str) -> NDArray[np.float64]:
        """(N, ...) a field of MjData."""
        return self._state.derived(name)

    def model_values(self, name: str) -> NDArray[Any]:
        """(N or 1, ...) a field of MjModel; colours are those of the marks."""
        values = self._state.model_values(name)
        if name != "geom_rgba":
            return values
        shape = (self.num_envs, self.model.ngeom, 4)
        rgba = np.array(np.broadcast_to(values.reshape(len(values), -1, 4), shape))
        for mark in self._marks:
            self._paint(rgba, mark)
        return rgba

    def _paint(self, rgba: NDArray[Any], mark: Mark) -> None:
        """Write the colours of a marked object, (N, ngeom, 4)."""
        body = self.model.body(mark.uid).id
        geoms = np.flatnonzero(self.model.geom_bodyid == body)
        halo = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_GEOM, f"{mark.uid}/{HALO}")
        if halo >= 0:
            rgba[:, halo, 3] = _HALO_ALPHA
        if mark.reached is not None:
            envs = np.flatnonzero(self._is_reached(body, mark.reached))
            rgba[envs[:, None], geoms, :3] = mark.reached.color

    def _is_reached(self, body: int, reached: Reached) -> NDArray[np.bool_]:
        """(N,) whether the point is near."""
        other = self.model.body(reached.body).id
        gaps = self._point_on(body, reached.offset) - self._point_on(other, reached.pos)
        return np.asarray(np.linalg.norm(gaps, axis=1) <= reached.within)

    def _point_on(self, body: int, pos: tuple[float, ...]) -> NDArray[np.float64]:
        """(N, 3) a point of a body, in the world."""
        origin = self.derived("xpos").reshape(self.num_envs, -1, 3)[:, body]
        axes = self.derived("xmat").reshape(self.num_envs, -1, 3, 3)[:, body]
        return np.asarray(origin + axes @ np.asarray(pos, np.float64))
