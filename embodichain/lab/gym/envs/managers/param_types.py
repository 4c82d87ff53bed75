"""Types of term parameters, for annotations: numbers with their ranges, and references.

``mass: Positive`` is checked when a config is read. ``of: Joints`` is written ``{uid: ...}`` in a
config and arrives as a `ResolvedEntity` with joints; ``of: Body`` may name a link, site or geom,
``of: Whole`` may not. ``sensor: ContactOf`` is written as a sensor's name and arrives as that
sensor. Imports no torch and no MuJoCo.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.sensors import (
        BaseSensor,
        Camera,
        ContactSensor,
        ForceTorqueSensor,
        HeightScanSensor,
        ImuSensor,
    )
    from embodichain.utils.array_types import Floats

__all__ = [
    "Angle",
    "Arm",
    "Axes6",
    "Body",
    "Bounds",
    "BoundsOrBox",
    "Box",
    "Box1",
    "Box2",
    "Box3",
    "CameraOf",
    "Command",
    "ContactHistoryOf",
    "ContactOf",
    "ForceTorqueOf",
    "Fraction",
    "Frames",
    "HeightScanOf",
    "ImuOf",
    "JointRange",
    "Joints",
    "Links",
    "NamedEntity",
    "NonNegative",
    "PlanarCommand",
    "PoseCommand",
    "PositionCommand",
    "Positive",
    "Range",
    "Ranges",
    "Reference",
    "ScaleRange",
    "SensorOf",
    "UnitInterval",
    "Vec3",
    "VelocityCommand",
    "Whole",
    "of_bodies",
    "of_command",
    "references",
]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
"""(0, 1]."""
UnitInterval = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
"""[0, 1]."""
Angle = Annotated[float, Field(gt=0, le=math.pi, allow_inf_nan=False)]
"""Radians in (0, pi]."""
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vec2 = Annotated[list[Finite], Field(min_length=2, max_length=2)]
Vec3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]


def _ordered(value: Sequence[Sequence[float]]) -> Sequence[Sequence[float]]:
    if len(value[0]) != len(value[1]):
        raise ValueError(f"low has {len(value[0])} values, high {len(value[1])}")
    for axis, (low, high) in enumerate(zip(value[0], value[1], strict=True)):
        if low > high:
            raise ValueError(f"low {low} exceeds high {high} in column {axis}")
    return value


def _ordered_pair(value: Sequence[float]) -> Sequence[float]:
    if value[0] > value[1]:
        raise ValueError(f"low {value[0]} exceeds high {value[1]}")
    return value


def _bounds(value: Sequence[float]) -> Sequence[float]:
    if math.isnan(value[0]) or math.isnan(value[1]):
        raise ValueError("a bound is not a number")
    return _ordered_pair(value)


Range = Annotated[
    Sequence[Finite], Field(min_length=2, max_length=2), AfterValidator(_ordered_pair)
]
"""[low, high]."""
Bounds = Annotated[Sequence[float], Field(min_length=2, max_length=2), AfterValidator(_bounds)]
"""[low, high]; either may be infinite (``.inf`` in YAML)."""
Box = Annotated[
    list[Annotated[list[Finite], Field(min_length=1)]],
    Field(min_length=2, max_length=2),
    AfterValidator(_ordered),
]
"""[[low of each column], [high of each]]."""
Box1 = Annotated[
    list[Annotated[list[Finite], Field(min_length=1, max_length=1)]],
    Field(min_length=2, max_length=2),
    AfterValidator(_ordered),
]
"""[[low], [high]]."""
Box2 = Annotated[list[Vec2], Field(min_length=2, max_length=2), AfterValidator(_ordered)]
"""[[x, y] low, [x, y] high]."""
Box3 = Annotated[list[Vec3], Field(min_length=2, max_length=2), AfterValidator(_ordered)]
"""[[x, y, z] low, [x, y, z] high]."""


def _named_form(value: Any) -> str:
    return "by name" if isinstance(value, Mapping) else "for all"


def _axis_form(value: Any) -> str:
    is_nested = isinstance(value, Sequence) and any(isinstance(v, Sequence) for v in value)
    return "by axis" if is_nested else "for all"


def _any_form(value: Any) -> str:
    return "by name" if isinstance(value, Mapping) else _axis_form(value)


def _scale_form(value: Any) -> str:
    if _axis_form(value) == "for all":
        return "for all"
    has_one_axis = all(isinstance(bound, Sequence) and len(bound) == 1 for bound in value)
    return "for all axes" if has_one_axis else "by axis"


Ranges = Annotated[
    Annotated[Range, Tag("for all")] | Annotated[dict[str, Range], Tag("by name")],
    Discriminator(_named_form),
]
"""[low, high] for all, or {name regex: [low, high]}."""
JointRange = Annotated[
    Annotated[Range, Tag("for all")]
    | Annotated[Box, Tag("by axis")]
    | Annotated[dict[str, Range], Tag("by name")],
    Discriminator(_any_form),
]
"""[low, high] for all joints, [[low of each joint], [high of each]], or {joint regex: pair}."""
BoundsOrBox = Annotated[
    Annotated[Bounds, Tag("for all")]
    | Annotated[Box, Tag("by axis")]
    | Annotated[dict[str, Bounds], Tag("by name")],
    Discriminator(_any_form),
]
"""[low, high], either infinite, [[low of each column], [high of each]], or {name regex: pair}."""
ScaleRange = Annotated[
    Annotated[Range, Tag("for all")]
    | Annotated[Box1, Tag("for all axes")]
    | Annotated[Box3, Tag("by axis")],
    Discriminator(_scale_form),
]
"""[low, high], [[low], [high]], or [[x, y, z] low, [x, y, z] high]."""
Axes6 = dict[Literal["x", "y", "z", "roll", "pitch", "yaw"], Range]
"""{axis: [low, high]}: m and rad, or m/s and rad/s; an axis that is absent is 0."""


@dataclass
class NamedEntity:
    """Refers to an entity without joints or links, such as a light."""

    __pydantic_config__ = {"extra": "forbid"}

    uid: str


class Reference:
    """Mark in ``Annotated[..., mark]``: checks and resolves a value that refers to something."""

    def check(self, task: EnvCfg, value: Any) -> list[Problem]:
        """Return the mistakes in a value that the task alone shows; their paths are empty."""
        return []

    def resolve(self, env: TermContext, value: Any) -> Any:
        """Return the object that the term receives for a value.

        Raises:
            ConfigError: If it does not exist; paths are empty, or the entity's.
        """
        return value


def references(hint: Any) -> Iterator[Reference]:
    """Yield the marks within an annotation, also of members of unions and of lists."""
    for part in getattr(hint, "__metadata__", ()):
        if isinstance(part, Reference):
            yield part
    for part in typing.get_args(hint):
        yield from references(part)


def of_bodies(marks: Iterable[Reference]) -> bool:
    """Whether marks are of a parameter that picks bodies, links, sites or geoms, not joints."""
    return any(isinstance(mark, (_Links, _Body, _Frames)) for mark in marks)


def of_command(marks: Iterable[Reference]) -> bool:
    """Whether marks are of a parameter that names a command."""
    return any(isinstance(mark, _Command) for mark in marks)


class _Entity(Reference):
    """An entity as `resolve` checks it; subclasses say which part of it a term uses."""


class _Whole(_Entity):
    def resolve(self, env: TermContext, value: Any) -> Any:
        entities = value if isinstance(value, (list, tuple)) else [value]
        for entity in entities:
            entity.require_whole()
        return value


class _Joints(_Whole):
    def resolve(self, env: TermContext, value: Any) -> Any:
        value.require_joints()
        return super().resolve(env, value)


class _Links(_Entity):
    def resolve(self, env: TermContext, value: Any) -> Any:
        value.require_links()
        return value


class _Body(_Entity):
    def resolve(self, env: TermContext, value: Any) -> Any:
        _ = value.frame_name  # raises where several are picked
        return value


class _Frames(_Entity):
    """Any number of links, sites or geoms."""


@dataclass(frozen=True)
class _Sensor(Reference):
    """A sensor of one kind, recognized by a method; sensors added in Python may have it too."""

    kind: str
    method: str
    others: tuple[str, ...] = ()
    """Further values of ``sensor_type`` of this kind."""

    def check(self, task: EnvCfg, value: Any) -> list[Problem]:
        types = {uid: cfg.sensor_type for uid, cfg in task.sensors.items()}
        allowed_types = (self.kind, *self.others)
        if types.get(str(value), self.kind) in allowed_types:
            return []
        allowed_uids = [uid for uid, kind in types.items() if kind in allowed_types]
        return [self._wrong_kind(value, allowed_uids)]

    def resolve(self, env: TermContext, value: Any) -> Any:
        allowed_uids = [uid for uid, sensor in env.sensors.items() if hasattr(sensor, self.method)]
        if value in allowed_uids:
            return env.sensors[value]
        if value in env.sensors:
            raise ConfigError([self._wrong_kind(value, allowed_uids)])
        message = f"no sensor is called {value!r}; {self._listed(allowed_uids)}"
        raise ConfigError([Problem("", message, did_you_mean(value, allowed_uids).strip())])

    def _wrong_kind(self, value: Any, allowed_uids: Iterable[str]) -> Problem:
        message = f"{value!r} is not a sensor of type {self.kind}; {self._listed(allowed_uids)}"
        return Problem("", message)

    def _listed(self, uids: Iterable[str]) -> str:
        return f"{self.kind} sensors: {', '.join(uids) or 'none'}"


class _ContactHistory(_Sensor):
    """A contact sensor that keeps the physics steps of a control step."""

    def resolve(self, env: TermContext, value: Any) -> Any:
        sensor = super().resolve(env, value)
        sensor.keep_history()
        return sensor


class _AnySensor(Reference):
    """A sensor of any kind with named readings."""

    def resolve(self, env: TermContext, value: Any) -> Any:
        uids = [uid for uid, sensor in env.sensors.items() if hasattr(sensor, "reads")]
        if value in uids:
            return env.sensors[value]
        message = f"no sensor is called {value!r}; sensors: {', '.join(uids) or 'none'}"
        raise ConfigError([Problem("", message, did_you_mean(value, uids).strip())])


@dataclass(frozen=True)
class _Command(Reference):
    """A command with a minimum number of columns; resolves to a function that reads it, (N, K)."""

    columns: int = 0

    def resolve(self, env: TermContext, value: Any) -> Any:
        manager = env.command_manager
        manager.require(value, "")
        count = manager.values(value).shape[1]
        if count < self.columns:
            message = f"command {value!r} has {count} columns, at least {self.columns} are needed"
            raise ConfigError([Problem("", message)])
        return lambda: manager.values(value)


# Entities: a config has a map, which pydantic checks as `ResolvedEntity` says; a term receives one.
Joints = Annotated[
    ResolvedEntity,
    _Joints(),
    Field(description="The robot; its joint names or control parts pick joints."),
]
Whole = Annotated[ResolvedEntity, _Whole(), Field(description="The entity.")]
Links = Annotated[ResolvedEntity, _Links(), Field(description="The entity, or links of one.")]
Body = Annotated[
    ResolvedEntity, _Body(), Field(description="The entity, or a link, site or geom of one.")
]
Frames = Annotated[
    ResolvedEntity, _Frames(), Field(description="The entity, or links, sites or geoms of one.")
]
Arm = Annotated[
    ResolvedEntity,
    _Frames(),
    Field(
        description="The robot; control parts or joint names pick the joints that move, a link or "
        "site is the tool."
    ),
]


def _name(mark: Reference, description: str) -> Any:
    """The type of a name in a config that `mark` checks and resolves."""
    return Annotated[str, mark, Field(description=description)]


# Sensors and commands: a config has a name, which pydantic checks; a term receives the sensor, or a
# function that reads the command, which type checkers are to see.
if TYPE_CHECKING:
    CameraOf = Camera
    ContactOf = ContactSensor
    ContactHistoryOf = ContactSensor
    ImuOf = ImuSensor
    ForceTorqueOf = ForceTorqueSensor
    HeightScanOf = HeightScanSensor
    SensorOf = BaseSensor
    Command = Callable[[], Floats]
    PlanarCommand = Command
    PositionCommand = Command
    VelocityCommand = Command
    PoseCommand = Command
else:
    CameraOf = _name(
        _Sensor("camera", "get_intrinsics", ("stereo_camera", "Camera", "StereoCamera")),
        "A camera.",
    )
    ContactOf = _name(_Sensor("contact", "read_force"), "A contact sensor.")
    ContactHistoryOf = _name(_ContactHistory("contact", "read_largest_force"), "A contact sensor.")
    ImuOf = _name(_Sensor("imu", "read_acceleration"), "An IMU.")
    ForceTorqueOf = _name(_Sensor("force_torque", "read_torque"), "A force-torque sensor.")
    HeightScanOf = _name(_Sensor("height_scan", "read_height"), "A height scan.")
    SensorOf = _name(_AnySensor(), "A sensor of any kind.")
    Command = _name(_Command(), "The command.")
    PlanarCommand = _name(_Command(2), "A command whose first two columns are vx and vy, m/s.")
    PositionCommand = _name(
        _Command(3), "A command whose first columns are x, y, z in the root's frame, m."
    )
    VelocityCommand = _name(_Command(3), "A command whose columns are vx, vy (m/s) and wz (rad/s).")
    PoseCommand = _name(
        _Command(7), "A command of x, y, z in m and a wxyz quaternion, in the root's frame."
    )
