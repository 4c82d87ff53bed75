"""`BodyMotion`: pose and velocity of one frame of a body, each computed once per state."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.lab.sim.reads.gravity import gravity_direction
from embodichain.utils.arrays import is_host, may_be_set
from embodichain.utils.math import norm, quat_to_matrix, rotate, rotate_back

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.lab.sim.reads.frames import BodyFrames
    from embodichain.utils.array_types import Floats

__all__ = ["BodyMotion", "Frame"]

Frame = Literal["world", "body", "yaw"]


class BodyMotion:
    """Motion of a frame's origin in N environments, float64. Do not write to its arrays.

    All terms that read a frame share one object. Computed values are stored until the engine's
    `version` changes.

    Args:
        engine: The engine.
        index: The entity that the frame belongs to.
        frame: One frame: that of a body, of a site or of a geom.
    """

    def __init__(self, engine: Engine, index: EntityIndex, frame: BodyFrames) -> None:
        self._engine = engine
        self._frame = frame
        self._version = -1
        self._computed: dict[Hashable, Floats] = {}
        is_root = frame.kind == "link" and frame.ids == index.root_body_id
        self._qvel = index.free_qvel_adr if is_root else -1
        # Poses of floating and kinematic roots are part of the state.
        self._pose = _pose_in_state(engine, index) if is_root else None
        # On the host an engine's field stays where it is: the view of its columns is made once.
        self._position_field = frame.position_field
        self._field: Floats | None = None
        self._position: Floats = np.zeros((0, 3))

    def release(self) -> None:
        """Drop the engine and its arrays, which terms would keep; nothing can be read then."""
        del self._engine, self._pose, self._field, self._position
        self._computed.clear()

    def position(self) -> Floats:
        """(N, 3) m: a live view, do not store."""
        if self._pose is not None:
            return self._pose.position
        field = self._engine.derived(self._position_field)
        if field is not self._field:
            if not is_host(field):
                return field[:, self._frame.ids]
            self._field = field
            self._position = field[:, self._frame.ids]
        return self._position

    def vector_to(self, other: BodyMotion) -> Floats:
        """(N, 3) m from this origin to another one."""
        key = ("vector", other)
        vector = self._stored(key)
        if vector is None:
            vector = other.position() - self.position()
            self._computed[key] = vector
        return vector

    def distance_to(self, other: BodyMotion) -> Floats:
        """(N,) m from this origin to another one."""
        key = ("distance", other)
        distance = self._stored(key)
        if distance is None:
            distance = norm(self.vector_to(other))
            self._computed[key] = distance
        return distance

    def orientation(self) -> Floats:
        """(N, 4) wxyz: a live view, do not store."""
        if self._pose is not None:
            return self._pose.quat
        if self._frame.kind == "link":
            return self._frame.orientations(self._engine)
        quat = self._stored("quat")
        if quat is None:
            quat = self._frame.orientations(self._engine)
            self._computed["quat"] = quat
        return quat

    def _stored(self, name: Hashable) -> Floats | None:
        """The value of the present state that is stored by a name, or None."""
        version = self._engine.version
        if self._version == version:
            return self._computed.get(name)
        self._computed.clear()
        self._version = version
        return None

    def axes(self) -> Floats:
        """(N, 3, 3) rotation matrices; the columns are the frame's axes in the world."""
        if self._frame.kind != "link":
            return self._frame.axes(self._engine)
        axes = self._stored("axes")
        if axes is None:
            axes = quat_to_matrix(self.orientation())
            self._computed["axes"] = axes
        return axes

    def gravity(self) -> Floats:
        """(N, 3) unit vector of gravity in the frame's axes; zeros where there is no gravity."""
        gravity = self._stored("gravity")
        if gravity is None:
            gravity = rotate_back(self.axes(), gravity_direction(self._engine))
            self._computed["gravity"] = gravity
        return gravity

    def linear_velocity(self, frame: Frame = "world") -> Floats:
        """(N, 3) m/s of the origin.

        For a floating root it is read from qvel; else see `point_velocities`.

        Args:
            frame: The axes: of the ``world``, of the frame itself (``body``), or of its heading
                (``yaw``): world axes rotated about z towards the frame's x axis.
        """
        key = ("linear", frame)
        velocity = self._stored(key)
        if velocity is None:
            velocity = self._linear(frame)
            self._computed[key] = velocity
        return velocity

    def _linear(self, frame: Frame) -> Floats:
        if frame != "world":
            return self._rotate_to(self.linear_velocity(), frame)
        if self._qvel >= 0:
            return self._engine.state("qvel")[:, self._qvel : self._qvel + 3]
        return self._frame.velocities(self._engine)[0]

    def angular_velocity(self, frame: Frame = "world") -> Floats:
        """(N, 3) rad/s; see `linear_velocity`."""
        key = ("angular", frame)
        velocity = self._stored(key)
        if velocity is None:
            velocity = self._angular(frame)
            self._computed[key] = velocity
        return velocity

    def _angular(self, frame: Frame) -> Floats:
        if self._qvel >= 0 and frame != "yaw":  # qvel is in body axes
            in_body = self._engine.state("qvel")[:, self._qvel + 3 : self._qvel + 6]
            return in_body if frame == "body" else rotate(self.axes(), in_body)
        if frame == "world":
            return self._engine.derived("cvel")[:, self._frame.bodies, :3]
        return self._rotate_to(self.angular_velocity(), frame)

    def _rotate_to(self, vectors: Floats, frame: Literal["body", "yaw"]) -> Floats:
        """Transform (N, 3) vectors from world axes to axes of the body or of its heading."""
        if frame == "body":
            return rotate_back(self.axes(), vectors)
        cos, sin = self._heading()
        x = vectors[:, 0]
        y = vectors[:, 1]
        level = vectors.copy()
        level[:, 0] = cos * x + sin * y
        level[:, 1] = cos * y - sin * x
        return level

    def _heading(self) -> tuple[Floats, Floats]:
        """(N,) cosine and sine of the heading; (1, 0) for a vertical x axis."""
        axes = self.axes()
        x = axes[:, 0, 0]
        y = axes[:, 1, 0]
        length = np.sqrt(x * x + y * y)
        is_vertical = length == 0.0
        if not may_be_set(is_vertical):
            return x / length, y / length
        length[is_vertical] = 1.0
        return np.where(is_vertical, 1.0, x / length), y / length


@dataclass(frozen=True, eq=False)
class _StatePose:
    """Live views of a root's pose in the state: (N, 3) m and (N, 4) wxyz."""

    position: Floats
    quat: Floats


def _pose_in_state(engine: Engine, index: EntityIndex) -> _StatePose | None:
    """Return the views of an entity's root, or None where it is fixed."""
    mocap = index.mocap_id
    if mocap >= 0:
        position = engine.state("mocap_pos")[:, 3 * mocap : 3 * mocap + 3]
        quat = engine.state("mocap_quat")[:, 4 * mocap : 4 * mocap + 4]
        return _StatePose(position, quat)
    start = index.free_qpos_adr
    if start >= 0:
        qpos = engine.state("qpos")
        return _StatePose(qpos[:, start : start + 3], qpos[:, start + 3 : start + 7])
    return None
