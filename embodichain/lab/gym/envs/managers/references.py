"""References: annotations of parameters that name something of the task, or want it to have joints.

``of: Joints`` is written ``{uid: ...}`` in a config and arrives as a `ResolvedEntity` with joints;
``sensor: ContactOf`` is written as a sensor's name and arrives as that sensor. Imports no torch.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.sensors.sensor_handles import (
        ContactSensor,
        ForceTorqueSensor,
        ImuSensor,
    )

__all__ = [
    "Body",
    "Command",
    "ContactOf",
    "ForceTorqueOf",
    "ImuOf",
    "Joints",
    "PlanarCommand",
    "PoseCommand",
    "PositionCommand",
    "Reference",
    "VelocityCommand",
    "references",
]


class Reference:
    """Mark of an annotation ``Annotated[..., mark]``: what a value means, and whether it exists."""

    def check(self, task: EnvCfg, value: Any) -> list[Problem]:
        """Return what is wrong with a value as far as the task alone shows, paths left empty."""
        return []

    def resolve(self, env: TermContext, value: Any) -> Any:
        """Return what the term receives.

        Raises:
            ConfigError: If there is no such thing; paths are empty, or the entity's own.
        """
        return value


def references(hint: Any) -> Iterator[Reference]:
    """The marks within an annotation, also of members of unions."""
    for part in getattr(hint, "__metadata__", ()):
        if isinstance(part, Reference):
            yield part
    for part in typing.get_args(hint):
        if hasattr(part, "__metadata__"):
            yield from references(part)


class _Joints(Reference):
    def resolve(self, env: TermContext, value: Any) -> Any:
        value.require_joints()
        return value


class _Body(Reference):
    def resolve(self, env: TermContext, value: Any) -> Any:
        _ = value.link_name  # raises where several are picked
        return value


@dataclass(frozen=True)
class _Sensor(Reference):
    """A sensor of one kind, told by a method that subclasses of an environment may provide too."""

    kind: str
    method: str

    def check(self, task: EnvCfg, value: Any) -> list[Problem]:
        types = {uid: cfg.sensor_type for uid, cfg in task.sensors.items()}
        if types.get(str(value), self.kind) == self.kind:
            return []
        return [self._another(value, [uid for uid, kind in types.items() if kind == self.kind])]

    def resolve(self, env: TermContext, value: Any) -> Any:
        there = [uid for uid, sensor in env.sensors.items() if hasattr(sensor, self.method)]
        if value in there:
            return env.sensors[value]
        if value in env.sensors:
            raise ConfigError([self._another(value, there)])
        message = f"no sensor is called {value!r}; {self._known(there)}"
        raise ConfigError([Problem("", message, did_you_mean(value, there).strip())])

    def _another(self, value: Any, there: Iterable[str]) -> Problem:
        return Problem("", f"{value!r} is no {self.kind} sensor; {self._known(there)}")

    def _known(self, there: Iterable[str]) -> str:
        return f"{self.kind} sensors: {', '.join(there) or 'none'}"


@dataclass(frozen=True)
class _Command(Reference):
    """A command with at least so many columns; arrives as a function that reads it, (N, K)."""

    columns: int = 0

    def resolve(self, env: TermContext, value: Any) -> Any:
        manager = env.command_manager
        manager.require(value, "")
        found = manager.values(value).shape[1]
        if found < self.columns:
            message = f"command {value!r} has {found} columns, at least {self.columns} are needed"
            raise ConfigError([Problem("", message)])
        return lambda: manager.values(value)


if TYPE_CHECKING:
    Joints = ResolvedEntity
    Body = ResolvedEntity
    ContactOf = ContactSensor
    ImuOf = ImuSensor
    ForceTorqueOf = ForceTorqueSensor
    Command = Callable[[], F64]
    PlanarCommand = Command
    PositionCommand = Command
    VelocityCommand = Command
    PoseCommand = Command
else:
    Joints = Annotated[ResolvedEntity, _Joints()]
    """A robot or articulation, and joints of it."""
    Body = Annotated[ResolvedEntity, _Body()]
    """An entity, or one link of it."""
    ContactOf = Annotated[str, _Sensor("contact", "read_force")]
    """A contact sensor."""
    ImuOf = Annotated[str, _Sensor("imu", "read_acceleration")]
    """An inertial measurement unit."""
    ForceTorqueOf = Annotated[str, _Sensor("force_torque", "read_torque")]
    """A force-torque sensor."""
    Command = Annotated[str, _Command()]
    """A command: a function that returns it, (N, K) float64, a live view."""
    PlanarCommand = Annotated[str, _Command(2)]
    """A command whose first two columns are vx and vy, m/s."""
    PositionCommand = VelocityCommand = Annotated[str, _Command(3)]
    """A command of three columns at least: x, y, z in m; or vx, vy in m/s and wz in rad/s."""
    PoseCommand = Annotated[str, _Command(7)]
    """A command (N, 7): x, y, z in m and a wxyz quaternion."""
