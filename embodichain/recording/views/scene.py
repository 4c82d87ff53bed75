"""Scenes for viewers: bodies (`/env_I/scene`) and commands (`/env_I/markers`) of an environment.

A scene has one `SceneEntity` for each body, attached to the body's frame. Shapes are Foxglove's
primitives; meshes are embedded as GLB models. A commanded pose is drawn as axes, a commanded
velocity as arrows; goals that are bodies are part of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.views.channels import frame_names
from embodichain.recording.views.shapes import MEDIA_TYPE, PLANE_SIZE, Shape, glb, mesh_of, shapes
from embodichain.utils.array_types import EnvIds
from embodichain.utils.math import quat_multiply

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["Commands", "Scenes"]

AXIS_LENGTH = 0.15
METRES_PER_SPEED = 0.5
"""Length of an arrow in metres for each m/s or rad/s."""
ABOVE = 0.25
"""Height of velocity arrows above the body's origin, metres."""
_RED = Color(r=0.9, g=0.2, b=0.2, a=1.0)
_GREEN = Color(r=0.2, g=0.8, b=0.2, a=1.0)
_BLUE = Color(r=0.2, g=0.4, b=1.0, a=1.0)
_SQRT_HALF = math.sqrt(0.5)
_TO_AXES = np.array(
    [
        [1.0, 0.0, 0.0, 0.0],
        [_SQRT_HALF, 0.0, 0.0, _SQRT_HALF],
        [_SQRT_HALF, 0.0, -_SQRT_HALF, 0.0],
    ]
)
"""Rotations, wxyz, of the x axis (the direction of arrows) to each axis."""


class Scenes:
    """Encodes scenes; meshes are encoded once for all environments.

    Args:
        ground: Width at which an infinite plane is drawn, metres.
    """

    def __init__(self, ground: float = PLANE_SIZE) -> None:
        self._ground = min(ground, PLANE_SIZE)
        self._meshes: dict[tuple[int, int], bytes] = {}

    def encode(self, time_ns: int, model: mujoco.MjModel, env_id: int) -> bytes:
        """Return the serialized `SceneUpdate` that replaces all entities of an environment.

        Args:
            time_ns: Time of the message.
            model: The environment's model; its meshes must be the same in every call.
            env_id: The environment.
        """
        names = frame_names(model, env_id)
        update = SceneUpdate()
        entities: dict[int, Any] = {}
        for shape in shapes(model):
            entity = entities.get(shape.body)
            if entity is None:
                name = names[shape.body]
                entity = update.entities.add(frame_id=name, id=name, frame_locked=True)
                entities[shape.body] = entity
                entity.timestamp.FromNanoseconds(time_ns)
            self._draw(entity, model, shape)
        data: bytes = update.SerializeToString()
        return data

    def _draw(self, entity: Any, model: mujoco.MjModel, shape: Shape) -> None:
        """Add the primitives of a shape."""
        size = 2 * shape.half
        color = Color(**dict(zip("rgba", shape.rgba.tolist(), strict=True)))
        common = {"pose": _pose(shape), "color": color}
        if shape.kind == "box":
            if int(model.geom_type[shape.geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE):
                size[:2] = np.where(model.geom_size[shape.geom][:2] > 0, size[:2], self._ground)
            entity.cubes.add(size=_xyz(size), **common)
        elif shape.kind == "ellipsoid":
            entity.spheres.add(size=_xyz(size), **common)
        elif shape.kind == "mesh":
            entity.models.add(
                scale=Vector3(x=1.0, y=1.0, z=1.0),
                data=self._mesh(model, shape.geom),
                media_type=MEDIA_TYPE,
                override_color=True,
                **common,
            )
        else:  # a cylinder; a capsule is drawn as a cylinder with two spheres
            entity.cylinders.add(size=_xyz(size), bottom_scale=1.0, top_scale=1.0, **common)
            if shape.kind == "capsule":
                ball = _xyz(size[[0, 0, 0]])
                for end in (-shape.half[2], shape.half[2]):
                    entity.spheres.add(size=ball, pose=_pose(shape, along_z=end), color=color)

    def _mesh(self, model: mujoco.MjModel, geom: int) -> bytes:
        key = (int(model.geom_type[geom]), int(model.geom_dataid[geom]))
        if key not in self._meshes:
            self._meshes[key] = glb(mesh_of(model, geom))
        return self._meshes[key]


def _pose(shape: Shape, along_z: float = 0.0) -> Pose:
    """A shape's pose in its body, moved along the shape's z axis."""
    axis = np.empty(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, along_z]), shape.quat)
    w, x, y, z = shape.quat.tolist()
    return Pose(position=_xyz(shape.pos + axis), orientation=Quaternion(x=x, y=y, z=z, w=w))


def _xyz(values: F64) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


class Commands:
    """The values and markers of an environment's commands, of which there may be none."""

    def __init__(self, env: ObservedEnv) -> None:
        manager = getattr(env, "command_manager", None)  # other classes may have no manager
        terms = {} if manager is None else manager.terms
        self._commands: dict[str, Any] = {name: term.instance for name, term in terms.items()}
        self._drawn = {
            name: command for name, command in self._commands.items() if command.marker is not None
        }
        # Names of the frames of bodies, after that of the environment.
        self._frames: list[str] = []
        if self._drawn:
            names = frame_names(env.sim.engine.model, 0)
            self._frames = [name.removeprefix("env_0") for name in names]

    @property
    def drawn(self) -> bool:
        """Whether any command has a marker."""
        return bool(self._drawn)

    def scalars(self) -> list[tuple[list[str], F64]]:
        """Names of the columns of each command, and its (N, columns) values, not copied."""
        scalars = []
        for name, command in self._commands.items():
            values = command.values
            labels = command.names or map(str, range(values.shape[1]))
            scalars.append(([f"{name}_{label}" for label in labels], values))
        return scalars

    def values_of(self, env_ids: EnvIds) -> list[F64]:
        """Copies of the (n, columns) values of each command that is drawn."""
        return [command.values[env_ids] for command in self._drawn.values()]

    def encode(
        self, time_ns: int, env_id: int, data: mujoco.MjData, values: Sequence[F64]
    ) -> bytes:
        """Return the serialized `SceneUpdate` of an environment's commands.

        Args:
            time_ns: Its time.
            env_id: The environment.
            data: Its kinematics.
            values: (columns,) values of each command that is drawn.
        """
        update = SceneUpdate()
        for (name, command), row in zip(self._drawn.items(), values, strict=True):
            is_pose = command.marker.kind == "pose"
            body = int(command.marker.body)
            entity = update.entities.add(id=f"env_{env_id}/commands/{name}")
            entity.timestamp.FromNanoseconds(time_ns)
            if is_pose:
                entity.frame_locked = True  # it moves with the body
                entity.frame_id = f"env_{env_id}{self._frames[body]}"
                _add_axes(entity.arrows, row)
            else:
                entity.frame_id = f"env_{env_id}{self._frames[0]}"
                _add_velocity(entity.arrows, row, data, body)
        encoded: bytes = update.SerializeToString()
        return encoded


def _add_axes(arrows: Any, pose: F64) -> None:
    """Add the axes of a frame: position and quaternion wxyz."""
    for quat, color in zip(quat_multiply(pose[3:], _TO_AXES), (_RED, _GREEN, _BLUE), strict=True):
        _add_arrow(arrows, pose[:3], quat, AXIS_LENGTH, color)


def _add_velocity(arrows: Any, command: F64, data: mujoco.MjData, body: int) -> None:
    """Add an arrow in the direction of motion in the plane, and one along z for the rotation.

    Args:
        arrows: The list of arrows to extend.
        command: Velocity forward, to the left (m/s), and about z (rad/s).
        data: Kinematics.
        body: The body that moves.
    """
    forward, left, turn = command.tolist()
    origin = data.xpos[body] + (0.0, 0.0, ABOVE)
    matrix = data.xmat[body]
    speed = math.hypot(forward, left)
    if speed:
        half = 0.5 * (math.atan2(matrix[3], matrix[0]) + math.atan2(left, forward))
        rotation = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        _add_arrow(arrows, origin, rotation, METRES_PER_SPEED * speed, _GREEN)
    if turn:
        rotation = np.array([_SQRT_HALF, 0.0, math.copysign(_SQRT_HALF, -turn), 0.0])
        _add_arrow(arrows, origin, rotation, METRES_PER_SPEED * abs(turn), _BLUE)


def _add_arrow(arrows: Any, origin: F64, quat: F64, length: float, color: Color) -> None:
    head_length = min(0.3 * length, 0.06)
    arrow = arrows.add(
        shaft_length=length - head_length,
        head_length=head_length,
        shaft_diameter=0.015,
        head_diameter=0.035,
        color=color,
    )
    position = arrow.pose.position
    orientation = arrow.pose.orientation
    position.x, position.y, position.z = origin.tolist()
    orientation.w, orientation.x, orientation.y, orientation.z = quat.tolist()
