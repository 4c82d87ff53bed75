"""MuJoCo's sensors on the links, sites and geoms of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from embodichain.utils.math import normalize_quat, quat_multiply, quat_rotate

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.names import FrameKind
    from embodichain.lab.sim.compiler.sensing.sensor_plans import SensorPlan

__all__ = ["add_frame_sensors", "object_type"]

_UNMOVED = (0.0, 0.0, 0.0)
_UNTURNED = (1.0, 0.0, 0.0, 0.0)
_SITE_RADIUS = 1e-3
_HIDDEN_GROUP = 5


def object_type(kind: FrameKind) -> mujoco.mjtObj:
    """Return MuJoCo's type of the objects whose frames links, sites or geoms are."""
    import mujoco  # configs of sensors are imported without it

    objects = {
        "link": mujoco.mjtObj.mjOBJ_XBODY,
        "site": mujoco.mjtObj.mjOBJ_SITE,
        "geom": mujoco.mjtObj.mjOBJ_GEOM,
    }
    return objects[kind]


def add_frame_sensors(
    spec: mujoco.MjSpec,
    plan: SensorPlan,
    types: Sequence[str],
    *,
    pos: Sequence[float] = _UNMOVED,
    quat: Sequence[float] = _UNTURNED,
    without_site: Sequence[FrameKind] = ("site",),
) -> None:
    """Add MuJoCo's sensors on each frame of a plan, called ``UID/FRAME/TYPE`` by number.

    Args:
        spec: The scene.
        plan: The sensor; its `others` are what the sensors measure relative to.
        types: MJCF's names of them: ``gyro``, ``framepos``.
        pos: Where they are in each frame, metres.
        quat: Their orientation there, wxyz.
        without_site: Kinds of frames on which MuJoCo has these types; others get a site of their
            own there, and so does each frame in which the sensors are moved or turned.
    """
    import mujoco  # configs of sensors are imported without it

    sensor_types = [getattr(mujoco.mjtSensor, f"mjSENS_{name.upper()}") for name in types]
    offset = np.asarray(pos, np.float64)
    turn = normalize_quat(np.asarray(quat, np.float64))
    is_moved = bool(offset.any()) or turn[0] != 1.0
    # The frame itself where possible, so that it follows the fields of an environment's model.
    needs_site = is_moved or plan.kind not in without_site
    measured_type = object_type("site" if needs_site else plan.kind)
    for i, (frame, place) in enumerate(zip(plan.frames, plan.places, strict=True)):
        measured_name = frame
        if needs_site:
            measured_name = f"{plan.uid}/{i}"
            spec.body(place.body).add_site(
                name=measured_name,
                size=[_SITE_RADIUS] * 3,
                group=_HIDDEN_GROUP,
                pos=place.pos + quat_rotate(place.quat, offset),
                quat=quat_multiply(place.quat, turn),
            )
        for j, sensor_type in enumerate(sensor_types):
            sensor = spec.add_sensor(name=f"{plan.uid}/{i}/{j}", type=sensor_type)
            sensor.objtype = measured_type
            sensor.objname = measured_name
            for reference_type, reference in plan.others:
                sensor.reftype = reference_type
                sensor.refname = reference
