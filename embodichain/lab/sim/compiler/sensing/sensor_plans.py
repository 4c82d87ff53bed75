"""`SensorPlan`: a declared sensor with checked values and names; `SceneNames` looks names up."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from embodichain.lab.sim.compiler.names import (
    GROUND,
    FrameKind,
    Known,
    KnownObject,
    NamedBy,
    frame_in_model,
    frame_names,
    names_wrong_alias,
    no_such,
    pick,
)
from embodichain.lab.sim.compiler.scene.known import Place, place_of
from embodichain.lab.sim.configs.references import JointsCfg, LinksCfg
from embodichain.lab.sim.configs.sensor_cfg import SENSORS, SensorCfg
from embodichain.utils.errors import Problem

if TYPE_CHECKING:
    import mujoco

__all__ = ["SceneNames", "SensorFrames", "SensorPlan", "plan_sensor"]


@dataclass(frozen=True)
class SensorPlan:
    """A declared sensor with checked names.

    Attributes:
        uid: Its name.
        cfg: Its config.
        names: (n,) names of the links, sites or geoms it is fixed on, or of its joints; none for a
            camera or rays fixed in the environment.
        kind: Whether `frames` are links, sites or geoms.
        frames: (n,) their names in the model; empty for a sensor of joints.
        places: (n,) where the file has them: the body and the pose in its frame.
        joints: (n,) names of its joints in the model.
        named_by: The entries of the config that name them; none if it takes all.
        others: Objects with which contacts count, or in whose frame a pose is measured: MuJoCo's
            object type and name of each; empty is any object, or the world.
    """

    uid: str
    cfg: SensorCfg
    names: tuple[str, ...]
    kind: FrameKind = "link"
    frames: tuple[str, ...] = ()
    places: tuple[Place, ...] = ()
    joints: tuple[str, ...] = ()
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    named_by: tuple[NamedBy, ...] = ()

    @property
    def bodies(self) -> tuple[str, ...]:
        """(n,) names in the model of the bodies that carry the frames."""
        return tuple(place.body for place in self.places)


def plan_sensor(
    uid: str, cfg: SensorCfg, known: Known, *, ground: bool = True, open_scene: bool = False
) -> tuple[SensorPlan | None, list[Problem]]:
    """Check a sensor's config, and look up its links, joints and other names.

    Args:
        uid: Its name.
        cfg: Its config.
        known: The entities of the scene.
        ground: Whether the scene has the ground plane.
        open_scene: Whether Python code may add entities, so that unknown ones are allowed.

    Returns:
        The plan (None if something is wrong or unknown), and every mistake, with paths relative to
        the sensor's config.
    """
    sensor_type = getattr(cfg, "sensor_type", "")
    sensor = SENSORS.get(sensor_type)
    if sensor is None or not isinstance(cfg, sensor.config):
        name = sensor_type or type(cfg).__name__
        return None, [Problem("sensor_type", SENSORS.unknown(name))]
    problems = cfg.check()
    plan, mistakes = sensor.make_plan(uid, cfg, SceneNames(known, ground, open_scene))
    problems += mistakes
    return None if problems else plan, problems


@dataclass(frozen=True)
class SensorFrames:
    """Frames of an entity that a sensor is fixed on, or with which it has to do.

    Attributes:
        kind: Whether they are links, sites or geoms.
        names: Their names.
        in_model: Their names in the model.
        places: Where the file has them.
        named_by: The entries that name them; none if all were taken.
    """

    kind: FrameKind
    names: tuple[str, ...]
    in_model: tuple[str, ...]
    places: tuple[Place, ...]
    named_by: tuple[NamedBy, ...]

    def plan(
        self, uid: str, cfg: SensorCfg, others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    ) -> SensorPlan:
        """The plan of a sensor that is fixed on them."""
        return SensorPlan(
            uid=uid,
            cfg=cfg,
            names=self.names,
            kind=self.kind,
            frames=self.in_model,
            places=self.places,
            named_by=self.named_by,
            others=others,
        )


@dataclass(frozen=True)
class SceneNames:
    """The names of a scene, which references of sensors are looked up in.

    Attributes:
        known: Its entities.
        ground: Whether it has the ground plane.
        open_scene: Whether unknown entities are allowed.
    """

    known: Known
    ground: bool
    open_scene: bool

    def frames(self, path: str, cfg: LinksCfg) -> tuple[SensorFrames | None, list[Problem]]:
        """Return the links, sites or geoms that a reference picks, and every mistake in it.

        None if something is wrong or unknown. By default it picks all links.

        Args:
            path: Its key path.
            cfg: The reference.
        """
        picked, problems = pick(path, vars(cfg), self.known, self.open_scene)
        entity = self.known.get(cfg.uid)
        if problems or entity is None or names_wrong_alias(vars(cfg), entity):
            return None, problems
        names = frame_names(entity, cfg.uid, picked.kind)
        if names is None:
            return None, []
        if not cfg.frame_keys():
            chosen = names
        elif picked.frames:
            chosen = tuple(names[i] for i in picked.frames)
        else:
            return None, [Problem(f"{path}.link_names", "names no link; leave it out for all")]
        frames = SensorFrames(
            kind=picked.kind,
            names=chosen,
            in_model=tuple(frame_in_model(entity, cfg.uid, picked.kind, name) for name in chosen),
            places=tuple(place_of(entity, cfg.uid, picked.kind, name) for name in chosen),
            named_by=picked.frames_by,
        )
        return frames, []

    def one(self, path: str, cfg: LinksCfg) -> tuple[SensorFrames | None, list[Problem]]:
        """Return the one link, site or geom that a reference picks, as `frames` does.

        By default it picks the root.
        """
        root = getattr(self.known.get(cfg.uid), "root_link_name", None)  # of an articulation
        if root is not None and not cfg.frame_keys():
            cfg = dataclasses.replace(cfg, link=root)
        frames, problems = self.frames(path, cfg)
        if frames is not None and len(frames.names) > 1:
            message = f"one {frames.kind} is wanted, these match: {', '.join(frames.names)}"
            return None, [Problem(f"{path}.{frames.kind}_names", message)]
        return frames, problems

    def plan_joints(
        self, uid: str, cfg: SensorCfg, joints: JointsCfg
    ) -> tuple[SensorPlan | None, list[Problem]]:
        """Return the plan of a sensor of the joints that its `of` picks, and every mistake in it.

        By default it picks all active joints.
        """
        for key in joints.frame_keys():
            return None, [Problem(f"of.{key}", "this sensor takes joint_names")]
        picked, problems = pick("of", vars(joints), self.known, self.open_scene)
        entity = self.known.get(joints.uid)
        if problems or entity is None:
            return None, problems
        if isinstance(entity, (str, KnownObject)):
            what = entity if isinstance(entity, str) else "rigid object"
            return None, [Problem("of.uid", f"{joints.uid!r} is a {what} without joints")]
        if not picked.joints:
            return None, [Problem("of", f"picks no joint of {joints.uid!r}")]
        names = tuple(entity.joint_names[i] for i in picked.joints)
        plan = SensorPlan(
            uid=uid,
            cfg=cfg,
            names=names,
            joints=tuple(f"{joints.uid}/{name}" for name in names),
            named_by=picked.joints_by,
        )
        return plan, []

    def plan_without_carrier(self, uid: str, cfg: SensorCfg) -> SensorPlan:
        """Return the plan of a sensor that is fixed in the environment, on nothing."""
        return SensorPlan(uid=uid, cfg=cfg, names=())

    def with_ground(self) -> SceneNames:
        """Return the names with that of the ground plane, if the scene has it."""
        if not self.ground:
            return self
        return dataclasses.replace(self, known={GROUND: "ground plane", **self.known})

    def check_entities(self, key: str, uids: Sequence[str] | None) -> list[Problem]:
        """Return the mistakes in a list of uids of entities, or of the ground plane."""
        if uids is None:
            return []
        names = [name for name, what in self.known.items() if what != "light"]
        names += [GROUND] if self.ground else []
        return [
            no_such("entity", uid, names, f"{key}.{i}")
            for i, uid in enumerate(uids)
            if uid not in names and (not self.open_scene or uid in self.known)
        ]
