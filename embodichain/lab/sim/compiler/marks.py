"""Marks of a compiled model: what pictures for people show beside the scene.

A mark is a text of the model, so the pictures of a log have it too. Nothing touches or measures it,
and cameras whose images are observations do not see it.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

import mujoco

__all__ = ["HALO", "MARK_PREFIX", "Mark", "Reached", "marks_of"]

MARK_PREFIX = "mark/"
"""Begin of the names of the model's texts that are marks; the object's uid follows."""
HALO = "halo"
"""Name of an object's halo among its geoms; in the model it is invisible."""


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
        """The text that the model has."""
        return json.dumps({"reached": None if self.reached is None else asdict(self.reached)})

    @classmethod
    def of_text(cls, uid: str, text: str) -> Mark:
        """Read what `as_text` wrote."""
        reached = json.loads(text)["reached"]
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
