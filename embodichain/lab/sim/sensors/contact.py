"""Contact sensors: whether links or geoms are touched, and the net force on each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from embodichain.lab.sim.compiler.names import GROUND, KnownObject
from embodichain.lab.sim.compiler.sensing.sensor_index import SensorIndex, own_columns
from embodichain.lab.sim.configs.references import LinksCfg
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.sensors.base_sensor import LastStepSensor, register_sensor
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.sensing.sensor_plans import (
        SceneNames,
        SensorFrames,
        SensorPlan,
    )
    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.lab.sim.sensors.sampling import Readings
    from embodichain.utils.array_types import Floats

__all__ = ["ContactSensor", "ContactSensorCfg"]

_NET_FORCE = 3
"""``reduce="netforce"`` in MJCF: one contact, the sum of all, in world axes."""


@configclass
class ContactSensorCfg(SensorCfg):
    """Contact of links or geoms: whether each is touched, and the net contact force on it."""

    reads: ClassVar[tuple[str, ...]] = ("found", "force")

    sensor_type: Literal["contact"] = "contact"
    against: LinksCfg | None = None
    """Count contacts with this entity (or links or geoms of it, or ``default_plane``) only."""
    history_length: Annotated[int, Field(ge=1)] | None = None
    """Number of last physics steps of which terms that ask whether there is contact
    (`contact_found`, `feet_air_time`) take the largest force; None is those of a control step.
    Readings of the sensor are those of the last one."""


@register_sensor(ContactSensorCfg)
class ContactSensor(LastStepSensor):
    """Contacts of n links with anything, or with the entity that the config names.

    Contacts belong to the acceleration stage: they are those of the last physics step or, after a
    reset, of the reset state. Shapes that cannot collide report nothing.

    Contacts that begin and end between two control steps are in `read_touched` and
    `read_largest_force`, which are of several physics steps (``history_length``).
    """

    cfg: ContactSensorCfg
    _depth = 0
    """Physics steps that are kept; 0 before `keep_history`."""

    # -- in the scene --------------------------------------------------------------------------

    @classmethod
    def make_plan(
        cls, uid: str, cfg: ContactSensorCfg, scene: SceneNames
    ) -> tuple[SensorPlan | None, list[Problem]]:
        """Look up its links or geoms, and those that it counts contacts with."""
        frames, problems = scene.frames("of", cfg.of)
        problems += _refuse_sites("of", frames)
        others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
        if cfg.against is not None:
            others, mistakes = _objects_against(cfg.against, scene)
            problems += mistakes
            if not others:
                frames = None
        if problems or frames is None:
            return None, problems
        return frames.plan(uid, cfg, others), []

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec, plan: SensorPlan) -> None:
        """Add a MuJoCo sensor for every pair of a link or geom and an object of `others`."""
        import mujoco  # configs of sensors are imported without it

        touched = _object_type(plan.kind)
        anything = ((mujoco.mjtObj.mjOBJ_UNKNOWN, ""),)
        fields = mujoco.mjtConDataField
        data = (1 << int(fields.mjCONDATA_FOUND)) | (1 << int(fields.mjCONDATA_FORCE))
        for i, frame in enumerate(plan.frames):
            for j, (other_type, other) in enumerate(plan.others or anything):
                sensor = spec.add_sensor(
                    name=f"{plan.uid}/{i}/{j}",
                    type=mujoco.mjtSensor.mjSENS_CONTACT,
                )
                sensor.objtype = touched
                sensor.objname = frame
                sensor.reftype = other_type
                sensor.refname = other
                sensor.intprm[:3] = [data, _NET_FORCE, 1]

    @classmethod
    def find_index(
        cls, model: mujoco.MjModel, plan: SensorPlan, entities: Mapping[str, EntityIndex]
    ) -> SensorIndex:
        """Return its columns, (links, others, 4): number of contacts, then force in N."""
        return own_columns(model, plan.uid, (len(plan.names), max(1, len(plan.others)), 4))

    @classmethod
    def notes(cls, model: mujoco.MjModel, plan: SensorPlan) -> list[str]:
        """Say so if nothing that it is on can collide."""
        collides = (model.geom_contype | model.geom_conaffinity) != 0
        # A file's own pairs collide whatever their masks are.
        collides[np.concatenate([model.pair_geom1, model.pair_geom2])] = True
        if plan.kind == "geom":
            can_touch = collides[[model.geom(name).id for name in plan.frames]].any()
        else:
            links = [model.body(name).id for name in plan.bodies]
            can_touch = np.isin(links, model.geom_bodyid[collides]).any()
        if can_touch:
            return []
        return [f"no shape of {', '.join(plan.frames)} collides, so it reports no contact"]

    # -- reading -------------------------------------------------------------------------------

    def bind(self, engine: Engine, index: SensorIndex) -> None:
        """Set the engine and the sensor's columns. Called once, by the simulation."""
        super().bind(engine, index)
        if self.cfg.history_length is not None:
            self.keep_history()

    def keep_history(self) -> None:
        """Keep the readings of several physics steps from now on; it costs a little time."""
        if self._depth:
            return
        self._depth = self.cfg.history_length or self.sim.physics_steps_per_control
        self.engine.keep_sensors(self.index.columns, self._depth)
        self._sampler.reset(None)

    def measure(self, env_ids: EnvIndex | None) -> Readings:
        """(n, links, others, 4) contacts; with a history also largest forces, and touches."""
        contacts = super().measure(env_ids)
        if not self._depth:
            return contacts
        steps = self.engine.kept_sensors(self.index.columns, self._depth)
        if env_ids is not None:
            steps = steps[env_ids]
        data = steps.reshape(len(steps), self._depth, *self.index.shape)
        force = data[..., 0, 1:]
        count = data[..., 0, 0]  # of contacts
        for other in range(1, self.index.shape[1]):
            force = force + data[..., other, 1:]
            count = count + data[..., other, 0]
        x = force[..., 0]
        y = force[..., 1]
        z = force[..., 2]
        lengths = np.sqrt(x * x + y * y + z * z)
        return *contacts, lengths.max(axis=1), count.max(axis=1) > 0

    def read_largest_force(self) -> Floats:
        """(N, n) N: largest net force on each link in the last ``history_length`` physics steps.

        The first call begins to keep them.
        """
        self.keep_history()
        return self.latest()[1].copy()

    def read_touched(self) -> NDArray[np.bool_]:
        """(N, n) whether each link was touched in one of these physics steps."""
        self.keep_history()
        return self.latest()[2].copy()

    def read_found(self) -> NDArray[np.bool_]:
        """(N, n) whether each link is touched."""
        has_contact = self.latest()[0][..., 0] > 0
        touched: NDArray[np.bool_] = has_contact[:, :, 0]
        for other in range(1, has_contact.shape[2]):
            touched = touched | has_contact[:, :, other]
        return touched

    def read_force(self) -> Floats:
        """(N, n, 3) N: net force that contacts exert on each link, world axes."""
        forces = self.latest()[0][..., 1:]
        # MuJoCo reports the force of the link on the other body.
        net: Floats = 0.0 - forces[:, :, 0]
        for other in range(1, forces.shape[2]):
            net -= forces[:, :, other]
        return net


def _object_type(kind: str) -> mujoco.mjtObj:
    """MuJoCo's type of links or geoms as things that touch."""
    import mujoco

    return mujoco.mjtObj.mjOBJ_BODY if kind == "link" else mujoco.mjtObj.mjOBJ_GEOM


def _refuse_sites(path: str, frames: SensorFrames | None) -> list[Problem]:
    if frames is None or frames.kind != "site":
        return []
    message = "a site touches nothing: name the geom or the link that carries it"
    return [Problem(f"{path}.site_names", message)]


def _objects_against(
    cfg: LinksCfg, scene: SceneNames
) -> tuple[tuple[tuple[mujoco.mjtObj, str], ...], list[Problem]]:
    """Objects with which contacts count: the ground's geom, an entity's tree, links or geoms."""
    import mujoco

    if cfg.uid == GROUND and scene.ground:
        for key in cfg.frame_keys():
            return (), [Problem(f"against.{key}", f"{GROUND!r} has no links, sites or geoms")]
        return ((mujoco.mjtObj.mjOBJ_GEOM, GROUND),), []
    scene = scene.with_ground()
    frames, problems = scene.frames("against", cfg)
    problems += _refuse_sites("against", frames)
    entity: Any = scene.known.get(cfg.uid)
    if problems or frames is None or entity is None:
        return (), problems
    if not cfg.frame_keys() and not isinstance(entity, (str, KnownObject)):
        return ((mujoco.mjtObj.mjOBJ_XBODY, f"{cfg.uid}/{entity.root_link_name}"),), []
    return tuple((_object_type(frames.kind), name) for name in frames.in_model), []
