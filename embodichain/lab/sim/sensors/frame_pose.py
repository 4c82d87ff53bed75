"""Sensors of poses: position, orientation and velocities of a frame."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar, Literal

from embodichain.lab.sim.compiler.names import frame_names, no_such
from embodichain.lab.sim.compiler.sensing.frame_sensors import add_frame_sensors, object_type
from embodichain.lab.sim.configs.references import LinksCfg
from embodichain.lab.sim.configs.scene_cfg import Orientation, Vec3
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.sensors.base_sensor import BaseSensor, register_sensor
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.sensing.sensor_plans import SceneNames, SensorPlan
    from embodichain.utils.array_types import Floats

__all__ = ["FramePoseSensor", "FramePoseSensorCfg"]


@configclass
class FramePoseSensorCfg(SensorCfg):
    """Pose and velocity of a frame: of one link (by default the root), site or geom."""

    reads: ClassVar[tuple[str, ...]] = (
        "position",
        "orientation",
        "linear_velocity",
        "angular_velocity",
    )

    sensor_type: Literal["frame_pose"] = "frame_pose"
    site: str | None = None
    """A site: the same as ``of.site``."""
    pos: Vec3 = (0.0, 0.0, 0.0)
    """The frame's origin, metres in the frame of that link, site or geom."""
    quat: Orientation = (1.0, 0.0, 0.0, 0.0)
    """The frame's orientation, wxyz in that frame."""
    relative_to: LinksCfg | None = None
    """A link (by default the root), site or geom in whose frame to measure; None is the world."""

    def check(self) -> list[Problem]:
        """Check that a site is named once, and that it alone says where the frame is."""
        if self.site is None:
            return []
        problems = []
        frame_keys = self.of.frame_keys()
        if frame_keys:
            problems.append(Problem("site", f"give a site or {frame_keys[0]}, not both"))
        if any(self.pos) or tuple(self.quat) != (1, 0, 0, 0):
            message = "has its own pose: leave pos and quat out, or name it in `of`"
            problems.append(Problem("site", message))
        return problems


@register_sensor(FramePoseSensorCfg)
class FramePoseSensor(BaseSensor):
    """Pose and velocity of a frame, in the world or in the frame of another link.

    They are those of the current state. In the frame of another link, velocities are those that an
    observer on that link measures, along its axes: its own motion is subtracted.
    """

    cfg: FramePoseSensorCfg

    @classmethod
    def make_plan(
        cls, uid: str, cfg: FramePoseSensorCfg, scene: SceneNames
    ) -> tuple[SensorPlan | None, list[Problem]]:
        """Look up the frame, and the one in which it is measured."""
        reference = cfg.of
        if cfg.site is not None:
            reference = dataclasses.replace(reference, site=cfg.site)
        frames = None
        problems: list[Problem] = []
        if not cfg.check():  # else it is not known which frame is meant
            problems = _check_site(cfg, scene)
            if not problems:
                frames, problems = scene.one("of", reference)
        others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
        if cfg.relative_to is not None:
            observer, mistakes = scene.one("relative_to", cfg.relative_to)
            problems = problems + mistakes
            if observer is None:
                frames = None
            else:
                others = tuple((object_type(observer.kind), name) for name in observer.in_model)
        if problems or frames is None:
            return None, problems
        return frames.plan(uid, cfg, others), []

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec, plan: SensorPlan) -> None:
        """Add its four MuJoCo sensors: m, wxyz, m/s and rad/s."""
        types = (
            "framepos",
            "framequat",
            "framelinvel",
            "frameangvel",
        )
        cfg: FramePoseSensorCfg = plan.cfg  # type: ignore[assignment]
        add_frame_sensors(
            spec, plan, types, pos=cfg.pos, quat=cfg.quat, without_site=("site", "geom")
        )

    def read_position(self) -> Floats:
        """(N, 3) m."""
        return self.latest()[0][:, 0:3].copy()

    def read_orientation(self) -> Floats:
        """(N, 4) wxyz."""
        return self.latest()[0][:, 3:7].copy()

    def read_linear_velocity(self) -> Floats:
        """(N, 3) m/s of the frame's origin."""
        return self.latest()[0][:, 7:10].copy()

    def read_angular_velocity(self) -> Floats:
        """(N, 3) rad/s."""
        return self.latest()[0][:, 10:13].copy()


def _check_site(cfg: FramePoseSensorCfg, scene: SceneNames) -> list[Problem]:
    """Check that the entity has the site that is named beside it."""
    entity = scene.known.get(cfg.of.uid)
    names = None if entity is None else frame_names(entity, cfg.of.uid, "site")
    if names is None or cfg.site is None or cfg.site in names:
        return []
    return [no_such("site", cfg.site, names or ("none",), "site")]
