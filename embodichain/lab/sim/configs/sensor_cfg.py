"""`SensorCfg`, the base of the configs of sensors, and `SENSORS`, the register of their types.

A type of sensor is one file, which has its config beside it: those of this package are in
`lab/sim/sensors/`, those of other packages are found by entry point.
"""

from __future__ import annotations

import importlib
import operator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Union

from pydantic import Field

from embodichain.lab.sim.configs.references import OF, JointsCfg, LinksCfg
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem
from embodichain.utils.fields.type_errors import from_dict, member_from_dict
from embodichain.utils.fields.value_checks import is_positive, require
from embodichain.utils.register import Register

__all__ = ["SENSORS", "AnySensorCfg", "JointsCfg", "LinksCfg", "SensorCfg", "sensor_configs"]

_SENSORS = "embodichain.lab.sim.sensors"

SENSORS: Register[Any] = Register(
    "sensor type",
    group="embodichain.sensors",
    modules=(f"{_SENSORS}.*",),
)
"""``sensor_type`` -> a subclass of `BaseSensor`, registered with `register_sensor`."""


def sensor_configs() -> dict[str, type[SensorCfg]]:
    """Return the config class of each registered ``sensor_type``."""
    return {name: sensor.config for name, sensor in SENSORS.items()}


@configclass
class SensorCfg:
    """Base of the configs of sensors; `sensor_type` chooses the concrete one.

    A subclass has a `sensor_type` that is a ``Literal``, its own keys, and, if its keys allow more
    than their types say, a `check`.
    """

    other_names: ClassVar[dict[str, str]] = {"entity_cfg": "of"}
    """Other names of keys -> the keys."""
    reads: ClassVar[tuple[str, ...]] = ()
    """Names of its readings, unless its keys choose them (`readings`)."""
    reads_images: ClassVar[bool] = False
    """Whether its readings are images, which observations contain as they are."""

    sensor_type: str = ""
    uid: str | None = None
    """Its key in a task."""
    of: Annotated[LinksCfg, OF] = LinksCfg()
    """The links, sites or geoms it is fixed on."""
    observe: bool = False
    """Whether ``obs["sensor"][uid]`` contains its data; terms can read it in either case."""
    rate: (
        Annotated[float, require("must be positive and finite, Hz, got {}", is_positive)] | None
    ) = None
    """Hz of simulated time; between measurements, reads return the last one. None measures at every
    read. A reset measures anew."""

    @property
    def entity_cfg(self) -> LinksCfg:
        """Another name of `of`."""
        return self.of

    @entity_cfg.setter
    def entity_cfg(self, reference: LinksCfg) -> None:
        self.of = reference

    def readings(self) -> tuple[str, ...]:
        """Return the names of the entries of the sensor's `get_data`."""
        return self.reads

    def check(self) -> list[Problem]:
        """Return the mistakes in its values that it alone shows, with paths below it.

        They are those of values that do not go together: what one value may be, its type says.
        References are checked where they are looked up.
        """
        return []

    def check_memory(self, num_envs: int) -> list[Problem]:
        """Return a problem if N environments' readings do not fit into the memory."""
        return []

    @classmethod
    def from_dict(cls, init_dict: dict[str, Any]) -> SensorCfg:
        """Build the sensor that ``init_dict["sensor_type"]`` names.

        Raises:
            ConfigError: If the type or a key is unknown; lists what exists.
        """
        if cls is not SensorCfg:
            return from_dict(cls, init_dict)
        return member_from_dict(sensor_configs(), "sensor_type", init_dict)


class _AnyRegistered:
    """Marks a config of any registered sensor.

    Pydantic asks for the union of them when it first checks one, so that declaring a task imports
    no sensor.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        members = tuple(dict.fromkeys(sensor_configs().values()))
        union: Any = Union[members]  # noqa: UP007
        return handler.generate_schema(Annotated[union, Field(discriminator="sensor_type")])


AnySensorCfg = Annotated[SensorCfg, _AnyRegistered()]
"""What YAML is checked against; `sensor_type` selects the registered config."""

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Configs of single sensors were here; they answer from `lab.sim.sensors`."""
        if name == "readings":
            return operator.methodcaller("readings")
        sensors = importlib.import_module(_SENSORS)
        if name.startswith("_") or name not in sensors.__all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(sensors, name)
