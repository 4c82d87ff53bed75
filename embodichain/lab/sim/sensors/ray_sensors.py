"""Sensors that cast rays: range finders and height scans. They need no OpenGL."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.names import GROUND
from embodichain.lab.sim.compiler.sensing.sensor_index import SensorIndex
from embodichain.lab.sim.configs.references import LinksCfg
from embodichain.lab.sim.configs.scene_cfg import Orientation, Vec3
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.reads.frames import BodyFrames, frame_named, link_frame
from embodichain.lab.sim.sensors.base_sensor import BaseSensor, register_sensor
from embodichain.lab.sim.sensors.ray_patterns import RayGridCfg, RayPatternCfg, pattern_rays
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem
from embodichain.utils.fields.value_checks import is_positive, require
from embodichain.utils.math import quat_to_matrix, rotate

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.index import EntityIndex, Mask
    from embodichain.lab.sim.compiler.sensing.sensor_plans import SceneNames, SensorPlan
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.reads.height_field import GroundHeights
    from embodichain.lab.sim.sensors.sampling import Readings
    from embodichain.utils.array_types import Floats

__all__ = [
    "HeightScanSensor",
    "HeightScanSensorCfg",
    "RayCastCfg",
    "RayCaster",
    "RaySensor",
    "RaySensorCfg",
]

_DOWN = (0.0, 0.0, -1.0)
GeomGroups = Annotated[
    list[int],
    require(
        "must be numbers from 0 to 5, got {}",
        lambda groups: bool(groups) and set(groups) <= set(range(6)),
    ),
]


@configclass
class RayCastCfg(SensorCfg):
    """Rays from one link (by default the root), site or geom; without `uid` from a fixed place."""

    pattern: RayPatternCfg = RayPatternCfg()
    pos: Vec3 = (0.0, 0.0, 0.0)
    """The sensor's origin, metres in the frame that `alignment` chooses."""
    quat: Orientation = (1.0, 0.0, 0.0, 0.0)
    """The sensor's orientation in that frame, wxyz."""
    alignment: Literal["base", "yaw", "world"] = "base"
    """Axes at that origin: of the link, site or geom, of its heading (z up), or of the world."""
    max_range: Annotated[
        float, require("must be positive and finite, metres, got {}", is_positive)
    ] = 10.0
    """Metres; surfaces further away count as not hit."""
    no_hit: Literal["max", "inf", "zero"] = "max"
    """Reading of a ray that hits nothing: as at `max_range`, infinity or 0."""
    hit: list[str] | None = None
    """Uids of the entities that rays can hit (or ``default_plane``); None is everything."""
    exclude: list[str] | None = None
    """Uids of entities that rays pass through; None is the entity that the sensor is fixed on."""
    geom_groups: GeomGroups = [0, 1, 2]
    """Groups of geoms that rays can hit: 0 to 2 are drawn, collision geoms are often in 3."""

    def check(self) -> list[Problem]:
        """Check its pattern, and what rays can hit and read."""
        problems = self.pattern.check()
        if self.observe and self.no_hit == "inf":
            problems.append(Problem("no_hit", "observations must be finite: use max or zero"))
        if self.hit is not None and not self.hit:
            problems.append(Problem("hit", "names no entity; leave it out for all"))
        return problems


RayReading = Literal["distance", "position", "normal"]


@configclass
class RaySensorCfg(RayCastCfg):
    """A range finder: distances along rays."""

    sensor_type: Literal["ray"] = "ray"
    data_types: list[RayReading] = ["distance"]
    """Entries of `get_data`."""

    def readings(self) -> tuple[str, ...]:
        """Return its `data_types`."""
        return tuple(self.data_types)

    def check(self) -> list[Problem]:
        """Check that it reads something."""
        problems = super().check()
        if not self.data_types:
            problems.append(Problem("data_types", "names no reading"))
        return problems


@configclass
class HeightScanSensorCfg(RayCastCfg):
    """Heights of the sensor above the surface below it, on a grid."""

    reads: ClassVar[tuple[str, ...]] = ("height",)

    sensor_type: Literal["height_scan"] = "height_scan"
    pattern: RayPatternCfg = RayPatternCfg(grid=RayGridCfg(size=(1.6, 1.0), resolution=0.1))
    alignment: Literal["base", "yaw", "world"] = "yaw"
    start_height: Annotated[
        float, require("must not be negative, metres, got {}", lambda z: 0 <= z < math.inf)
    ] = 1.0
    """Metres above the sensor where rays start, so that higher ground beside it is found."""

    def check(self) -> list[Problem]:
        """Check that its pattern is a grid."""
        problems = super().check()
        if self.pattern.grid is None:
            problems.append(Problem("pattern", "a height scan has a grid"))
        return problems


class _Cast(NamedTuple):
    """R rays in n environments, and what they hit.

    Attributes:
        place: (n, 3) the sensor's origin, metres.
        origins: (n, R, 3) metres.
        directions: (n, R, 3) unit vectors.
        distance: (n, R) metres; as `no_hit` says where nothing is hit.
        hit: (n, R) whether something is hit.
        normal: (n, R, 3) normals of the surfaces, if wanted.
    """

    place: Floats
    origins: Floats
    directions: Floats
    distance: Floats
    hit: NDArray[np.bool_]
    normal: Floats | None


class RayCaster(BaseSensor):
    """R rays from a link, site, geom or fixed place, against the geoms that its config chooses.

    Rays are cast when they are read, at the current positions. Geoms with alpha 0 are not hit.
    """

    of_positions = True
    cfg: RayCastCfg

    @classmethod
    def make_plan(
        cls, uid: str, cfg: RayCastCfg, scene: SceneNames
    ) -> tuple[SensorPlan | None, list[Problem]]:
        """Look up what it is fixed on, if anything, and the entities that rays can hit or not."""
        problems = scene.check_entities("hit", cfg.hit)
        problems += scene.check_entities("exclude", cfg.exclude)
        if cfg.of == LinksCfg():
            plan = None if problems else scene.plan_without_carrier(uid, cfg)
            return plan, problems
        frames, mistakes = scene.one("of", cfg.of)
        problems = mistakes + problems
        if problems or frames is None:
            return None, problems
        return frames.plan(uid, cfg), []

    @classmethod
    def find_index(
        cls, model: mujoco.MjModel, plan: SensorPlan, entities: Mapping[str, EntityIndex]
    ) -> SensorIndex:
        """Return the geoms that its rays can hit."""
        cfg: RayCastCfg = plan.cfg  # type: ignore[assignment]
        hits: Mask = np.isin(model.geom_group, cfg.geom_groups)
        if cfg.hit is not None:
            hits &= _geoms_of(model, cfg.hit, entities)
        excluded = cfg.exclude
        if excluded is None:
            carrier = cfg.of.uid
            excluded = [carrier] if carrier and carrier not in (cfg.hit or ()) else []
        return SensorIndex(geoms=hits & ~_geoms_of(model, excluded, entities))

    @cached_property
    def _rays(self) -> tuple[Floats, Floats]:
        """(R, 3) starts and unit directions in the frame that `alignment` chooses."""
        starts, directions = pattern_rays(self.cfg.pattern)
        quat = np.asarray(self.cfg.quat, np.float64)
        axes = quat_to_matrix(quat / np.linalg.norm(quat))
        return rotate(axes, starts) + np.asarray(self.cfg.pos, np.float64), rotate(axes, directions)

    @property
    def num_rays(self) -> int:
        """R."""
        return len(self._rays[0])

    @cached_property
    def _frame(self) -> BodyFrames:
        """What it is fixed on: a link, site or geom, or the world, which is body 0."""
        if not self.names:
            return link_frame(0)
        return frame_named(self.engine.model, self.plan.kind, self.plan.frames[0])

    def _mount(self, env_ids: EnvIndex | None) -> tuple[Floats, Floats]:
        """(n, 3) origin and (n, 3, 3) axes of the frame that `alignment` chooses."""
        where = slice(None) if env_ids is None else env_ids
        position = self._frame.positions(self.engine)[where]
        axes = self._frame.axes(self.engine)[where]
        if self.cfg.alignment == "yaw":
            axes = _heading(axes)
        elif self.cfg.alignment == "world":
            axes = np.broadcast_to(self.sim.arrays.constant(np.eye(3)), axes.shape)
        return position, axes

    def _cast(self, env_ids: EnvIndex | None, raised: float = 0.0, normal: bool = False) -> _Cast:
        """Cast the rays in n environments, from `raised` metres higher."""
        cfg = self.cfg
        starts, rays = self._rays
        position, axes = self._mount(env_ids)
        directions = rotate(axes[:, None], rays)
        origins = position[:, None] + rotate(axes[:, None], starts)
        origins[..., 2] += raised
        hits = self.engine.cast_rays(origins, directions, self.index.geoms, env_ids, normal=normal)
        is_hit = (hits.distance >= 0.0) & (hits.distance <= cfg.max_range)
        missing = {"max": cfg.max_range, "inf": np.inf, "zero": 0.0}[cfg.no_hit]
        return _Cast(
            place=position + rotate(axes, np.asarray(cfg.pos, np.float64)),
            origins=origins,
            directions=directions,
            distance=np.where(is_hit, hits.distance, missing),
            hit=is_hit,
            normal=hits.normal,
        )


@register_sensor(RaySensorCfg)
class RaySensor(RayCaster):
    """A range finder: distances along R rays, and the points and surfaces that they hit."""

    cfg: RaySensorCfg

    def measure(self, env_ids: EnvIndex | None) -> Readings:
        """(n, R) distances, (n, R, 3) points and, if `data_types` names them, (n, R, 3) normals."""
        cast = self._cast(env_ids, normal="normal" in self.cfg.data_types)
        hit = cast.hit[..., None]
        reached = np.where(np.isfinite(cast.distance), cast.distance, 0.0)[..., None]
        points = cast.origins + cast.directions * reached
        if self.cfg.no_hit == "inf":
            points = np.where(hit, points, np.inf)
        if cast.normal is None:
            return cast.distance, points
        return cast.distance, points, np.where(hit, cast.normal, 0.0)

    def read_distance(self) -> Floats:
        """(N, R) m along the rays; where nothing is hit, what `no_hit` says."""
        return self.latest()[0].copy()

    def read_position(self) -> Floats:
        """(N, R, 3) m: points that are hit, in the environment's frame.

        Where nothing is hit: the point at the distance that is read.
        """
        return self.latest()[1].copy()

    def read_normal(self) -> Floats:
        """(N, R, 3) unit normals of the surfaces that are hit, world axes; 0 where nothing is.

        Raises:
            ValueError: If the config's `data_types` does not contain ``normal``.
        """
        readings = self.latest()
        if len(readings) < 3:
            raise ValueError(f"{self.uid}: normals are not measured; add normal to data_types")
        return readings[2].copy()


@register_sensor(HeightScanSensorCfg)
class HeightScanSensor(RayCaster):
    """Heights of the sensor's origin above what is below the points of a grid.

    Rays start `start_height` above the sensor. Where they are vertical and can hit a terrain only,
    its heights are read instead.
    """

    cfg: HeightScanSensorCfg

    def measure(self, env_ids: EnvIndex | None) -> Readings:
        """(n, R) heights."""
        if self._ground is not None:
            return (self._above_ground(self._ground, env_ids),)
        cast = self._cast(env_ids, self.cfg.start_height)
        # A ray without a hit reads what the surface at its distance would give, or 0.
        reached = cast.origins[..., 2] + cast.directions[..., 2] * cast.distance
        height = cast.place[:, None, 2] - reached
        if self.cfg.no_hit == "zero":
            height = np.where(cast.hit, height, 0.0)
        return (height,)

    @cached_property
    def _ground(self) -> GroundHeights | None:
        """The terrain, if vertical rays could hit nothing else: then its heights are read."""
        _, rays = self._rays
        are_vertical = np.array_equal(rays, np.broadcast_to(_DOWN, rays.shape))
        if not are_vertical or self.cfg.alignment == "base":
            return None
        from embodichain.lab.sim.reads.height_field import (
            GroundHeights,  # few scenes have a terrain
        )

        return GroundHeights.hit_alone(self.engine, self.index.geoms)

    def _above_ground(self, ground: GroundHeights, env_ids: EnvIndex | None) -> Floats:
        """(n, R) m: what rays would measure, without rays."""
        cfg = self.cfg
        starts, _ = self._rays
        position, axes = self._mount(env_ids)
        points = position[:, None] + rotate(axes[:, None], starts)
        surface, has_ground = ground.read(points[..., 0], points[..., 1], env_ids)
        place = position + rotate(axes, np.asarray(cfg.pos, np.float64))
        height = place[:, None, 2] - surface
        start = points[..., 2] + cfg.start_height
        is_hit = has_ground & (start - surface <= cfg.max_range)
        if cfg.no_hit == "zero":
            return np.where(is_hit, height, 0.0)
        missing = np.inf if cfg.no_hit == "inf" else cfg.max_range - cfg.start_height
        return np.where(is_hit, height, missing)

    def destroy(self) -> None:
        """Drop the references to the engine."""
        super().destroy()
        self.__dict__.pop("_ground", None)

    def read_height(self) -> Floats:
        """(N, R) m; negative where the surface is above the sensor.

        Where nothing is hit: as if the surface were at `max_range`, infinite or 0 (`no_hit`).
        """
        return self.latest()[0].copy()


def _geoms_of(
    model: mujoco.MjModel, uids: Sequence[str], entities: Mapping[str, EntityIndex]
) -> Mask:
    """(ngeom,) the geoms of these entities."""
    geoms: Mask = np.zeros(model.ngeom, np.bool_)
    for uid in uids:
        if uid == GROUND:
            geoms[model.geom(GROUND).id] = True
        else:
            geoms[entities[uid].geom_ids] = True
    return geoms


def _heading(axes: Floats) -> Floats:
    """(n, 3, 3) axes of headings: z up, x along the horizontal part of x of (n, 3, 3) axes.

    The world's axes where x is vertical.
    """
    x = axes[:, 0, 0]
    y = axes[:, 1, 0]
    length = np.sqrt(x * x + y * y)
    is_vertical = length < 1e-9
    divisor = np.where(is_vertical, 1.0, length)
    cos = np.where(is_vertical, 1.0, x / divisor)
    sin = np.where(is_vertical, 0.0, y / divisor)
    heading: Floats = np.zeros_like(axes)
    heading[:, 0, 0] = cos
    heading[:, 0, 1] = -sin
    heading[:, 1, 0] = sin
    heading[:, 1, 1] = cos
    heading[:, 2, 2] = 1.0
    return heading
