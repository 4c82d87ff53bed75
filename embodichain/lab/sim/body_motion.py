"""`BodyMotion`: pose and velocity of one body, each computed once per state."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from embodichain.utils.math import cross, quat_to_matrix, rotate, rotate_back

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.api import F64, Engine

__all__ = ["BodyMotion", "Frame", "origin_velocities"]

Frame = Literal["world", "body", "yaw"]


class BodyMotion:
    """Motion of a body's origin in N environments, float64. Do not write to its arrays.

    All terms that read a body share one object. Computed values are stored until the engine's
    `version` changes.

    Args:
        engine: The engine.
        index: The entity that the body belongs to.
        body: MuJoCo's id of the body.
    """

    def __init__(self, engine: Engine, index: EntityIndex, body: int) -> None:
        self._engine = engine
        self._body = body
        self._version = -1
        self._known: dict[str, F64] = {}
        is_root = body == index.root_body_id
        self._qvel = index.free_qvel_adr if is_root else -1
        # Poses of floating and kinematic roots are part of the state.
        self._pose: tuple[F64, F64] | None = None
        start, mocap = index.free_qpos_adr, index.mocap_id
        if is_root and mocap >= 0:
            position, quat = engine.state("mocap_pos"), engine.state("mocap_quat")
            self._pose = (
                position[:, 3 * mocap : 3 * mocap + 3],
                quat[:, 4 * mocap : 4 * mocap + 4],
            )
        elif is_root and start >= 0:
            qpos = engine.state("qpos")
            self._pose = qpos[:, start : start + 3], qpos[:, start + 3 : start + 7]

    def release(self) -> None:
        """Drop the engine and its arrays, which terms would keep; nothing can be read then."""
        del self._engine, self._pose
        self._known.clear()

    def position(self) -> F64:
        """(N, 3) m: a live view, do not store."""
        return self._engine.derived("xpos")[:, self._body] if self._pose is None else self._pose[0]

    def orientation(self) -> F64:
        """(N, 4) wxyz: a live view, do not store."""
        return self._engine.derived("xquat")[:, self._body] if self._pose is None else self._pose[1]

    def _once(self, name: str, compute: Callable[[], F64]) -> F64:
        """The stored value, or a new one if the state has changed."""
        if self._version != self._engine.version:
            self._known.clear()
            self._version = self._engine.version
        found = self._known.get(name)
        if found is None:
            found = self._known[name] = compute()
        return found

    def axes(self) -> F64:
        """(N, 3, 3) rotation matrices; the columns are the body's axes in the world."""
        return self._once("axes", lambda: quat_to_matrix(self.orientation()))

    def linear_velocity(self, frame: Frame = "world") -> F64:
        """(N, 3) m/s of the origin.

        For a floating root it is read from qvel; else see `origin_velocities`.

        Args:
            frame: The axes: of the ``world``, of the ``body``, or of its heading (``yaw``): world
                axes rotated about z towards the body's x axis.
        """
        return self._once(f"linear {frame}", lambda: self._linear(frame))

    def _linear(self, frame: Frame) -> F64:
        if frame != "world":
            return self._turned(self.linear_velocity(), frame)
        if self._qvel >= 0:
            return self._engine.state("qvel")[:, self._qvel : self._qvel + 3]
        return origin_velocities(self._engine, self._body)[0]

    def angular_velocity(self, frame: Frame = "world") -> F64:
        """(N, 3) rad/s; see `linear_velocity`."""
        return self._once(f"angular {frame}", lambda: self._angular(frame))

    def _angular(self, frame: Frame) -> F64:
        if self._qvel >= 0 and frame != "yaw":  # qvel is in body axes
            own = self._engine.state("qvel")[:, self._qvel + 3 : self._qvel + 6]
            return own if frame == "body" else rotate(self.axes(), own)
        if frame == "world":
            return self._engine.derived("cvel")[:, self._body, :3]
        return self._turned(self.angular_velocity(), frame)

    def _turned(self, vectors: F64, frame: Literal["body", "yaw"]) -> F64:
        """Transform (N, 3) vectors from world axes to axes of the body or of its heading."""
        if frame == "body":
            return rotate_back(self.axes(), vectors)
        cos, sin = self._heading()
        x, y, level = vectors[:, 0], vectors[:, 1], vectors.copy()
        level[:, 0], level[:, 1] = cos * x + sin * y, cos * y - sin * x
        return level

    def _heading(self) -> tuple[F64, F64]:
        """(N,) cosine and sine of the heading; (1, 0) for a vertical x axis."""
        ahead, left = self.axes()[:, 0, 0], self.axes()[:, 1, 0]
        length = np.sqrt(ahead * ahead + left * left)
        vertical = length == 0.0
        length[vertical] = 1.0
        return np.where(vertical, 1.0, ahead / length), left / length


def origin_velocities(engine: Engine, bodies: Any) -> tuple[F64, F64]:
    """Velocities of bodies' origins, world axes.

    MuJoCo's `cvel` is (angular, linear) at the centre of mass of the kinematic tree; moved to the
    origin by v = v_com + w x (origin - com).

    Args:
        engine: The engine.
        bodies: B ids of bodies, a slice, or one id.

    Returns:
        Linear in m/s and angular in rad/s, (N, B, 3) each; (N, 3) of one id.
    """
    roots = engine.model.body_rootid[bodies].astype(np.int64)
    cvel = engine.derived("cvel")[:, bodies]
    arm = engine.derived("xpos")[:, bodies] - engine.derived("subtree_com")[:, roots]
    angular = cvel[..., :3]
    return cvel[..., 3:] + cross(angular, arm), angular
