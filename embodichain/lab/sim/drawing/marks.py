"""Marks of a compiled model: what pictures for people show beside the scene.

A mark is a text of the model, so the pictures of a log have it too. Nothing touches or measures it,
and cameras whose images are observations do not see it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any
from urllib.parse import quote, unquote

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.command_arrows import arrows_of
from embodichain.lab.sim.drawing.overlays import Arrows, Overlay, Spheres, ViewerGeom
from embodichain.lab.sim.drawing.views import DrawnState

__all__ = ["MARK_PREFIX", "Halo", "JointPast", "Mark", "MarkedState", "Near", "Reached", "marks_of"]

MARK_PREFIX = "mark/"
"""Begin of the names of the model's texts that are marks; what is marked follows."""
_HALO_ALPHA = 0.35
_COVER = 0.0005
"""Metres by which a cover is larger than what it covers."""
_SIMPLE = [
    int(mujoco.mjtGeom.mjGEOM_SPHERE),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_BOX),
]
"""`mjtGeom` of shapes that a size describes."""


@dataclass(frozen=True, kw_only=True)
class Halo:
    """A translucent sphere.

    Attributes:
        pos: (3,) metres, its middle in the frame of the marked body.
        radius: Metres.
        color: RGB in [0, 1].
    """

    pos: tuple[float, ...]
    radius: float
    color: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Near:
    """A point is near a point of the marked body.

    Attributes:
        body: The body that the point is fixed on.
        pos: (3,) metres, the point in that body's frame.
        offset: (3,) metres, the point of the marked body, in its frame.
        within: Metres, the largest distance.
    """

    body: str
    pos: tuple[float, ...]
    offset: tuple[float, ...]
    within: float


@dataclass(frozen=True, kw_only=True)
class JointPast:
    """A joint is past a position.

    Attributes:
        joint: The joint, with one degree of freedom.
        above: rad or m: the least position; None is no condition.
        below: rad or m: the largest position; None is no condition.
    """

    joint: str
    above: float | None
    below: float | None


@dataclass(frozen=True, kw_only=True)
class Reached:
    """When what is marked has another colour; one of the conditions is given.

    Attributes:
        color: RGB in [0, 1].
        near: While a point is near.
        joint: While a joint is past a position.
    """

    color: tuple[float, ...]
    near: Near | None = None
    joint: JointPast | None = None


@dataclass(frozen=True, kw_only=True)
class Mark:
    """How a body is marked.

    Attributes:
        body: Its name.
        halo: A sphere around it.
        reached: When it and its halo have another colour.
    """

    body: str
    halo: Halo | None = None
    reached: Reached | None = None

    def as_text(self) -> str:
        """The text that the model has: JSON whose quotation marks are percent-encoded.

        MJCF has a text with quotation marks in a CDATA section, which XML tools replace by plain
        text, and MuJoCo reads none.
        """
        return quote(json.dumps(asdict(self)), safe="{}[]:, ")

    @classmethod
    def of_text(cls, text: str) -> Mark:
        """Read what `as_text` wrote."""
        values = json.loads(unquote(text))
        halo = values["halo"]
        reached = values["reached"]
        if reached is not None:
            near = reached["near"]
            joint = reached["joint"]
            reached = Reached(
                color=reached["color"],
                near=None if near is None else Near(**near),
                joint=None if joint is None else JointPast(**joint),
            )
        return cls(
            body=values["body"],
            halo=None if halo is None else Halo(**halo),
            reached=reached,
        )


def marks_of(model: mujoco.MjModel) -> list[Mark]:
    """The marks of a compiled model."""
    marks: list[Mark] = []
    for index in range(model.ntext):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, index) or ""
        if name.startswith(MARK_PREFIX):
            start = int(model.text_adr[index])
            length = int(model.text_size[index]) - 1  # without the final zero
            text = bytes(model.text_data)[start : start + length].decode()
            marks.append(Mark.of_text(text))
    return marks


class MarkedState:
    """A state whose marked bodies look as they should, with an overlay; else it is as it was.

    Args:
        state: The environments.
        marks: Of its model.
    """

    def __init__(self, state: DrawnState, marks: list[Mark]) -> None:
        self._state = state
        self._marks = marks
        self._reached = [_is_reached(state, mark) for mark in marks]
        self.commands = state.commands

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

    def state(self, name: str) -> NDArray[np.float64]:
        """(N, ...) a component of the simulation's state."""
        return self._state.state(name)

    def model_values(self, name: str) -> NDArray[Any]:
        """(N or 1, ...) a field of MjModel; colours are those of what is reached."""
        values = self._state.model_values(name)
        if name != "geom_rgba" or not any(mark.reached for mark in self._marks):
            return values
        shape = (self.num_envs, self.model.ngeom, 4)
        rgba = np.array(np.broadcast_to(values.reshape(len(values), -1, 4), shape))
        for mark, is_reached in zip(self._marks, self._reached, strict=True):
            if mark.reached is not None:
                geoms = np.flatnonzero(self.model.geom_bodyid == self.model.body(mark.body).id)
                envs = np.flatnonzero(is_reached)
                rgba[envs[:, None], geoms, :3] = mark.reached.color
        return rgba

    @cached_property
    def overlay(self) -> Overlay:
        """Halos, and the arrows of commands."""
        shapes: list[Spheres | Arrows] = []
        for mark, is_reached in zip(self._marks, self._reached, strict=True):
            if mark.halo is not None:
                shapes.append(self._sphere(mark, mark.halo, is_reached))
        for command in self.commands:
            shapes += arrows_of(command, self._state)
        return Overlay(shapes)

    def viewer_geoms(self, env: int) -> list[ViewerGeom]:
        """What MuJoCo's viewers show of one environment, whose model they do not paint.

        That is the overlay, and a cover in the other colour around each simple shape of what is
        reached.
        """
        geoms = self.overlay.viewer_geoms(env)
        for mark, is_reached in zip(self._marks, self._reached, strict=True):
            if mark.reached is not None and is_reached[env]:
                geoms += self._covers(mark.body, mark.reached, env)
        return geoms

    def _covers(self, name: str, reached: Reached, env: int) -> Iterator[ViewerGeom]:
        model = self.model
        positions = self.derived("geom_xpos").reshape(self.num_envs, -1, 3)
        axes = self.derived("geom_xmat").reshape(self.num_envs, -1, 3, 3)
        colors = self._state.model_values("geom_rgba").reshape(-1, model.ngeom, 4)
        for geom in np.flatnonzero(model.geom_bodyid == model.body(name).id).tolist():
            is_seen = colors[min(env, len(colors) - 1), geom, 3] > 0.0
            if model.geom_type[geom] in _SIMPLE and is_seen and model.geom_group[geom] < 3:
                yield ViewerGeom(
                    kind=int(model.geom_type[geom]),
                    size=model.geom_size[geom] + _COVER,
                    pos=positions[env, geom],
                    axes=axes[env, geom],
                    color=np.array([*reached.color, 1.0]),
                )

    def _sphere(self, mark: Mark, halo: Halo, is_reached: NDArray[np.bool_]) -> Spheres:
        colors = np.empty((self.num_envs, 4))
        colors[:, :3] = halo.color
        colors[:, 3] = _HALO_ALPHA
        if mark.reached is not None:
            colors[is_reached, :3] = mark.reached.color
        positions = _point_on(self._state, mark.body, halo.pos)
        return Spheres(positions, halo.radius, colors)


def _is_reached(state: DrawnState, mark: Mark) -> NDArray[np.bool_]:
    """(N,) whether the condition of a mark holds; False of one without."""
    is_reached = np.zeros(state.num_envs, bool)
    if mark.reached is None:
        return is_reached
    if mark.reached.near is not None:
        near = mark.reached.near
        marked_point = _point_on(state, mark.body, near.offset)
        gaps = marked_point - _point_on(state, near.body, near.pos)
        return np.asarray(np.linalg.norm(gaps, axis=1) <= near.within)
    if mark.reached.joint is not None:
        past = mark.reached.joint
        start = int(state.model.jnt_qposadr[state.model.joint(past.joint).id])
        position = np.asarray(state.state("qpos"))[:, start]
        is_reached = np.ones(state.num_envs, bool)
        if past.above is not None:
            is_reached &= position >= past.above
        if past.below is not None:
            is_reached &= position <= past.below
    return is_reached


def _point_on(state: DrawnState, name: str, pos: tuple[float, ...]) -> NDArray[np.float64]:
    """(N, 3) a point of a body, in the world."""
    body = state.model.body(name).id
    origin = np.asarray(state.derived("xpos")).reshape(state.num_envs, -1, 3)[:, body]
    axes = np.asarray(state.derived("xmat")).reshape(state.num_envs, -1, 3, 3)[:, body]
    return np.asarray(origin + axes @ np.asarray(pos, np.float64))
