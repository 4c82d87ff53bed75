"""`BaseSensor`, a sensor in N environments, and `register_sensor`, which adds a type of sensor.

A type of sensor is one file: a `SensorCfg`, and a `BaseSensor` that is registered with it. The
class says what it looks up in a scene (`make_plan`), what it adds to the scene (`edit_spec`), where
its numbers are in the compiled model (`find_index`), and how it is read (`measure`, ``read_NAME``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.sensing.sensor_index import SensorIndex, own_columns
from embodichain.lab.sim.configs.sensor_cfg import SENSORS, SensorCfg
from embodichain.lab.sim.objects.entity import Handle
from embodichain.lab.sim.reads.frames import BodyFrames, frames_named
from embodichain.lab.sim.sensors.sampling import Readings, Sampler
from embodichain.utils.arrays import as_env_ids, to_tensor

if TYPE_CHECKING:
    import mujoco
    import torch

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.sensing.sensor_plans import SceneNames, SensorPlan
    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.lab.sim.objects.sim_context import SimContext
    from embodichain.utils.array_types import Floats
    from embodichain.utils.errors import Problem

__all__ = ["BaseSensor", "LastStepSensor", "register_sensor"]

Sensor = TypeVar("Sensor", bound="type[BaseSensor]")


def register_sensor(config: type[SensorCfg]) -> Callable[[Sensor], Sensor]:
    """Make a class the sensor of a config; its names are those of the config's `sensor_type`.

    Args:
        config: Its `sensor_type` is a ``Literal`` of one or more names, the first of which is the
            default.

    Returns:
        A decorator that returns its argument.

    Raises:
        TypeError: If the config names no types so.
        ValueError: If a name is taken by a sensor that is defined elsewhere.
    """
    hint = get_type_hints(config)["sensor_type"]
    names = get_args(hint) if get_origin(hint) is Literal else ()
    if not names or config().sensor_type != names[0]:
        raise TypeError(
            f"{config.__module__}:{config.__qualname__}: write the name of the sensor's type as "
            f'`sensor_type: Literal["NAME"] = "NAME"`'
        )

    def decorate(sensor: Sensor) -> Sensor:
        sensor.config = config
        return SENSORS.add(*names)(sensor)

    return decorate


class BaseSensor(Handle[SensorIndex]):
    """One sensor in N environments.

    Args:
        plan: Its config and the links or joints that it measures.
        host: The simulation.

    Attributes:
        config: The class of its configs.
        reads: Names of its measurements; each has a method ``read_NAME``, which returns (N, ...).
        cfg: Its config.
        uid: Its name.
        names: (n,) the links, sites or geoms it is fixed on, or the joints that it measures.
        reads_images: Whether its data are images, which observations contain as they are.
        of_positions: Whether its measurements follow from positions and the model alone; see
            `Sampler`.
    """

    config: ClassVar[type[SensorCfg]] = SensorCfg
    of_positions: ClassVar[bool] = False

    def __init__(self, plan: SensorPlan, host: SimContext) -> None:
        super().__init__(plan.uid, host)
        self.plan = plan
        self.cfg: SensorCfg = plan.cfg
        self.names = plan.names
        self.reads = plan.cfg.readings()

    def _repr_facts(self) -> dict[str, Any]:
        """Return what it is fixed on or measures, and its measurements."""
        return {"of": list(self.names), "reads": list(self.reads)}

    # -- in the scene --------------------------------------------------------------------------

    @classmethod
    def make_plan(
        cls, uid: str, cfg: Any, scene: SceneNames
    ) -> tuple[SensorPlan | None, list[Problem]]:
        """Look up the names in a config; by default `of` picks links, sites or geoms.

        Args:
            uid: The sensor.
            cfg: Its config.
            scene: The names there are.

        Returns:
            The plan (None if something is wrong or unknown), and every mistake, with paths relative
            to the config.
        """
        frames, problems = scene.frames("of", cfg.of)
        return (None if frames is None else frames.plan(uid, cfg)), problems

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec, plan: SensorPlan) -> None:
        """Add what it needs to the scene: MuJoCo's sensors and sites, called ``UID/...``."""

    @classmethod
    def find_index(
        cls, model: mujoco.MjModel, plan: SensorPlan, entities: Mapping[str, EntityIndex]
    ) -> SensorIndex:
        """Find its numbers in the compiled model; by default the columns of its MuJoCo sensors.

        Args:
            model: The compiled scene.
            plan: The sensor.
            entities: Indices of the entities in the model, by uid.
        """
        return own_columns(model, plan.uid)

    @classmethod
    def notes(cls, model: mujoco.MjModel, plan: SensorPlan) -> list[str]:
        """Return what a user should know of it in the compiled scene, one sentence each."""
        return []

    @property
    def observe(self) -> bool:
        """Whether ``obs["sensor"]`` contains its data."""
        return self.cfg.observe

    @cached_property
    def frames(self) -> BodyFrames:
        """The n links, sites or geoms it is fixed on, in the compiled scene."""
        return frames_named(self.engine.model, self.plan.kind, self.plan.frames)

    @property
    def body_ids(self) -> NDArray[np.int64]:
        """(n,) MuJoCo body ids of the links it is fixed on, or that carry its sites or geoms."""
        return self.frames.bodies

    # -- measuring -----------------------------------------------------------------------------

    def measure(self, env_ids: EnvIndex | None) -> Readings:
        """Measure n environments (None: all); returns arrays (n, ...), which may be live views.

        By default these are the columns of its MuJoCo sensors, of the current positions and
        velocities.
        """
        return (self.columns(self.engine.derived("sensordata"), env_ids),)

    def latest(self) -> Readings:
        """(N, ...) what `measure` returns, at the sensor's rate: do not write or store."""
        return self._sampler.read()

    def columns(self, rows: Floats, env_ids: EnvIndex | None) -> Floats:
        """(n, ...) the sensor's columns of ``sensordata`` in the shape of its index."""
        index = self.index
        data = rows[slice(None) if env_ids is None else env_ids, index.columns]
        return data.reshape(len(data), *index.shape)

    @cached_property
    def _sampler(self) -> Sampler:
        return Sampler(self.engine, self.sim.arrays, self.measure, self.cfg.rate, self.of_positions)

    # -- for tensors ---------------------------------------------------------------------------

    def get_data(self) -> dict[str, torch.Tensor]:
        """Return all `reads` as float32 tensors (N, ...), as in ``obs["sensor"][uid]``."""
        return {name: to_tensor(getattr(self, f"read_{name}")()) for name in self.reads}

    @property
    def reads_images(self) -> bool:
        """Whether its data are images, which observations contain as they are."""
        return self.cfg.reads_images

    # -- state ---------------------------------------------------------------------------------

    def reset(self, env_ids: Any = None) -> None:
        """Make a sensor with a rate measure at the next read; a simulation's reset calls it."""
        self._sampler.reset(as_env_ids(env_ids, self.num_instances))

    def state_dict(self) -> dict[str, Any]:
        """Readings that are kept until the next are due (copies); empty without a rate."""
        return self._sampler.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._sampler.load_state_dict(state)

    def destroy(self) -> None:
        """Drop the references to the engine."""
        super().destroy()
        self.__dict__.pop("_sampler", None)


class LastStepSensor(BaseSensor):
    """A sensor whose MuJoCo sensors belong to the acceleration stage: forces, accelerations.

    Their numbers are those of the last physics step or, after a reset, of the reset state.
    """

    def bind(self, engine: Engine, index: SensorIndex) -> None:
        """Set the engine and the sensor's columns. Called once, by the simulation."""
        super().bind(engine, index)
        # The first request of an acceleration field computes it, so make it here.
        engine.acceleration("sensordata")

    def measure(self, env_ids: EnvIndex | None) -> Readings:
        """The columns of its MuJoCo sensors, of the last physics step."""
        return (self.columns(self.engine.acceleration("sensordata"), env_ids),)
