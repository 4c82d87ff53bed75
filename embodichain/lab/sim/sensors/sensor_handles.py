"""Handles of sensors: contacts, forces at joints, inertial measurements, poses of frames."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.configs.sensor_cfg import readings
from embodichain.lab.sim.objects.entity import Handle
from embodichain.lab.sim.reads.frames import BodyFrames, frames_named
from embodichain.lab.sim.reads.gravity import gravity_direction
from embodichain.lab.sim.sensors.sampling import Readings, Sampler
from embodichain.utils.arrays import as_env_ids, to_tensor
from embodichain.utils.math import quat_conjugate, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.sensing.scene_sensors import SensorIndex
    from embodichain.lab.sim.compiler.sensing.sensor_plans import SensorPlan
    from embodichain.lab.sim.configs.sensor_cfg import ContactSensorCfg, SensorCfg
    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.lab.sim.objects.host import Host
    from embodichain.utils.array_types import Floats

__all__ = [
    "BaseSensor",
    "ContactSensor",
    "ForceTorqueSensor",
    "FramePoseSensor",
    "ImuSensor",
    "JointTorqueSensor",
]


class BaseSensor(Handle["SensorIndex"]):
    """One sensor in N environments.

    Args:
        plan: Its config and the links or joints that it measures.
        host: The simulation.

    Attributes:
        reads: Names of its measurements; each has a method ``read_NAME``.
        cfg: Its config.
        uid: Its name.
        names: (n,) the links, sites or geoms it is fixed on, or the joints that it measures.
        reads_images: Whether its data are images, which observations contain as they are.
        of_positions: Whether its measurements follow from positions and the model alone; see
            `Sampler`.
    """

    reads_images: ClassVar[bool] = False
    of_positions: ClassVar[bool] = False

    def __init__(self, plan: SensorPlan, host: Host) -> None:
        super().__init__(plan.uid, host)
        self.plan = plan
        self.cfg: SensorCfg = plan.cfg
        self.names = plan.names
        self.reads = readings(plan.cfg)

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

    def get_data(self) -> dict[str, torch.Tensor]:
        """Return all `reads` as float32 tensors (N, ...), as in ``obs["sensor"][uid]``."""
        return {name: to_tensor(getattr(self, f"read_{name}")()) for name in self.reads}

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

    @cached_property
    def _sampler(self) -> Sampler:
        return Sampler(
            self.engine, self.host.arrays, self._measure, self.cfg.rate, self.of_positions
        )

    def _readings(self) -> Readings:
        """(N, ...) what `_measure` returns, at the sensor's rate: do not write or store."""
        return self._sampler.read()

    def _measure(self, env_ids: EnvIndex | None) -> Readings:
        """Measure n environments (None: all); returns arrays (n, ...), which may be live views."""
        raise NotImplementedError

    def _columns(self, rows: Floats, env_ids: EnvIndex | None) -> Floats:
        """(n, ...) the sensor's columns of ``sensordata`` in the shape of its index."""
        index = self.index
        found = rows[slice(None) if env_ids is None else env_ids, index.columns]
        return found.reshape(len(found), *index.shape)


class _LastStepSensor(BaseSensor):
    """A sensor whose readings belong to the acceleration stage.

    They are those of the last physics step or, after a reset, of the reset state.
    """

    def bind(self, engine: Engine, index: SensorIndex) -> None:
        """Set the engine and the sensor's columns. Called once, by the simulation."""
        super().bind(engine, index)
        # The first request of an acceleration field computes it, so make it here.
        engine.acceleration("sensordata")

    def _measure(self, env_ids: EnvIndex | None) -> Readings:
        return (self._columns(self.engine.acceleration("sensordata"), env_ids),)


class ContactSensor(_LastStepSensor):
    """Contacts of n links with anything, or with the entity that the config names.

    Contacts belong to the acceleration stage: they are those of the last physics step or, after a
    reset, of the reset state. Shapes that cannot collide report nothing.

    Contacts that begin and end between two control steps are in `read_touched` and
    `read_largest_force`, which are of several physics steps (``history_length``).
    """

    cfg: ContactSensorCfg
    _depth = 0
    """Physics steps that are kept; 0 before `keep_history`."""

    def bind(self, engine: Engine, index: SensorIndex) -> None:
        """Set the engine and the sensor's columns. Called once, by the simulation."""
        super().bind(engine, index)
        if self.cfg.history_length is not None:
            self.keep_history()

    def keep_history(self) -> None:
        """Keep the readings of several physics steps from now on; it costs a little time."""
        if self._depth:
            return
        given = self.cfg.history_length
        self._depth = self.host.physics_steps_per_control if given is None else given
        self.engine.keep_sensors(self.index.columns, self._depth)
        self._sampler.reset(None)

    def _measure(self, env_ids: EnvIndex | None) -> Readings:
        now = super()._measure(env_ids)
        if not self._depth:
            return now
        steps = self.engine.kept_sensors(self.index.columns, self._depth)
        steps = steps if env_ids is None else steps[env_ids]
        data = steps.reshape(len(steps), self._depth, *self.index.shape)
        force = data[..., 0, 1:]
        found = data[..., 0, 0]
        for other in range(1, self.index.shape[1]):
            force = force + data[..., other, 1:]
            found = found + data[..., other, 0]
        x, y, z = force[..., 0], force[..., 1], force[..., 2]
        lengths = np.sqrt(x * x + y * y + z * z)
        return *now, lengths.max(axis=1), found.max(axis=1) > 0

    def read_largest_force(self) -> Floats:
        """(N, n) N: largest net force on each link in the last ``history_length`` physics steps.

        The first call begins to keep them.
        """
        self.keep_history()
        return self._readings()[1].copy()

    def read_touched(self) -> NDArray[np.bool_]:
        """(N, n) whether each link was touched in one of these physics steps."""
        self.keep_history()
        return self._readings()[2].copy()

    def read_found(self) -> NDArray[np.bool_]:
        """(N, n) whether each link is touched."""
        found = self._readings()[0][..., 0] > 0
        touched: NDArray[np.bool_] = found[:, :, 0]
        for other in range(1, found.shape[2]):
            touched = touched | found[:, :, other]
        return touched

    def read_force(self) -> Floats:
        """(N, n, 3) N: net force that contacts exert on each link, world axes."""
        forces = self._readings()[0][..., 1:]
        # MuJoCo reports the force of the link on the other body.
        net: Floats = 0.0 - forces[:, :, 0]
        for other in range(1, forces.shape[2]):
            net -= forces[:, :, other]
        return net


class ForceTorqueSensor(_LastStepSensor):
    """Force and torque that parents exert on n links, at each link's origin.

    They belong to the acceleration stage: they are those of the last physics step or, after a
    reset, of the reset state. At rest the force points up and equals the weight of the link and its
    descendants.
    """

    def read_force(self) -> Floats:
        """(N, n, 3) N, link axes."""
        return self._readings()[0][..., 0:3].copy()

    def read_torque(self) -> Floats:
        """(N, n, 3) N m about the link's origin, link axes."""
        return self._readings()[0][..., 3:6].copy()


class ImuSensor(_LastStepSensor):
    """An inertial measurement unit without noise; its axes are the link's, rotated by the config.

    Orientation and angular velocity are those of the current state. The specific force belongs to
    the acceleration stage: it is that of the last physics step or, after a reset, of the reset
    state.
    """

    def _measure(self, env_ids: EnvIndex | None) -> Readings:
        state = self._columns(self.engine.derived("sensordata"), env_ids)
        return state[:, 0:7], super()._measure(env_ids)[0][:, 7:10]

    def read_orientation(self) -> Floats:
        """(N, 4) wxyz orientation of the sensor in the world."""
        return self._readings()[0][:, 0:4].copy()

    def read_angular_velocity(self) -> Floats:
        """(N, 3) rad/s, sensor axes."""
        return self._readings()[0][:, 4:7].copy()

    def read_acceleration(self) -> Floats:
        """(N, 3) m/s^2 specific force (acceleration minus gravity), sensor axes.

        It is 9.81 upwards at rest and 0 in free fall.
        """
        return self._readings()[1].copy()

    def read_projected_gravity(self) -> Floats:
        """(N, 3) unit vector of gravity in sensor axes: (0, 0, -1) if upright; 0 without it."""
        quat = self.read_orientation()
        gravity = np.broadcast_to(gravity_direction(self.engine), (len(quat), 3))
        return quat_rotate(quat_conjugate(quat), gravity)


class FramePoseSensor(BaseSensor):
    """Pose and velocity of a frame, in the world or in the frame of another link.

    They are those of the current state. In the frame of another link, velocities are those that an
    observer on that link measures, along its axes: its own motion is subtracted.
    """

    def _measure(self, env_ids: EnvIndex | None) -> Readings:
        return (self._columns(self.engine.derived("sensordata"), env_ids),)

    def read_position(self) -> Floats:
        """(N, 3) m."""
        return self._readings()[0][:, 0:3].copy()

    def read_orientation(self) -> Floats:
        """(N, 4) wxyz."""
        return self._readings()[0][:, 3:7].copy()

    def read_linear_velocity(self) -> Floats:
        """(N, 3) m/s of the frame's origin."""
        return self._readings()[0][:, 7:10].copy()

    def read_angular_velocity(self) -> Floats:
        """(N, 3) rad/s."""
        return self._readings()[0][:, 10:13].copy()


class JointTorqueSensor(BaseSensor):
    """Generalized forces that act at n joints: N m of hinges, N of slides.

    They are those of the last physics step or, after a reset, of the reset state. At rest their sum
    balances gravity (``qfrc_bias``) and forces that are applied from outside.
    """

    def _measure(self, env_ids: EnvIndex | None) -> Readings:
        rows = slice(None) if env_ids is None else env_ids[:, None]
        fields = ("qfrc_actuator", "qfrc_passive", "qfrc_constraint")
        return tuple(self.engine.acceleration(name)[rows, self.index.dofs] for name in fields)

    def read_torque(self) -> Floats:
        """(N, n) sum of the other three."""
        actuator, passive, constraint = self._readings()
        return actuator + passive + constraint

    def read_actuator(self) -> Floats:
        """(N, n) of drives and other actuators (``qfrc_actuator``, `jointactuatorfrc`)."""
        return self._readings()[0].copy()

    def read_passive(self) -> Floats:
        """(N, n) of springs, dampers and gravity compensation (``qfrc_passive``)."""
        return self._readings()[1].copy()

    def read_constraint(self) -> Floats:
        """(N, n) of limits, dry friction, equalities and contacts (``qfrc_constraint``)."""
        return self._readings()[2].copy()
