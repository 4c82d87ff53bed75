"""The sensors of a scene: all of them are planned, added to the scene and found in the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from embodichain.lab.sim.compiler.names import GROUND, Known, check_uid
from embodichain.lab.sim.compiler.sensing.sensor_plans import SensorPlan, plan_sensor
from embodichain.lab.sim.configs.sensor_cfg import SENSORS, SensorCfg
from embodichain.utils.errors import Problem

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.sensing.sensor_index import SensorIndex

__all__ = ["add_sensor", "index_sensor", "notes_on_sensor", "plan_sensors"]


def plan_sensors(
    sensors: Mapping[str, SensorCfg],
    known: Known,
    *,
    ground: bool,
    open_scene: bool,
    num_envs: int,
) -> tuple[dict[str, SensorPlan], list[Problem]]:
    """Look up the links of all declared sensors of N environments; see `plan_sensor`.

    Returns:
        The plans of valid sensors, and every mistake, with paths relative to the task.
    """
    plans: dict[str, SensorPlan] = {}
    problems: list[Problem] = []
    used_names = {GROUND: "the ground plane", **dict.fromkeys(known, "an entity")}
    for uid, cfg in sensors.items():
        path = f"sensors.{uid}"
        problems += check_uid(uid, path, used_names)
        if cfg.uid not in (None, "", uid):
            message = f"the key {uid!r} is its uid; it cannot be {cfg.uid!r}: leave uid out"
            problems.append(Problem(f"{path}.uid", message))
        plan, mistakes = plan_sensor(uid, cfg, known, ground=ground, open_scene=open_scene)
        mistakes += cfg.check_memory(num_envs)
        problems += [mistake.below(path) for mistake in mistakes]
        if plan is not None:
            plans[uid] = plan
    return plans, problems


def add_sensor(spec: mujoco.MjSpec, plan: SensorPlan) -> None:
    """Add what a sensor needs to the scene: MuJoCo's sensors, sites and cameras, by its name."""
    SENSORS[plan.cfg.sensor_type].edit_spec(spec, plan)


def index_sensor(
    model: mujoco.MjModel, plan: SensorPlan, entities: Mapping[str, EntityIndex]
) -> SensorIndex:
    """Find a sensor's columns, joints, geoms and cameras in the compiled model.

    Args:
        model: The model.
        plan: The sensor.
        entities: Indices of the entities in the model, by uid.
    """
    return SENSORS[plan.cfg.sensor_type].find_index(model, plan, entities)


def notes_on_sensor(model: mujoco.MjModel, plan: SensorPlan) -> list[str]:
    """Return what a user should know of a sensor, such as that nothing can touch it."""
    notes: list[str] = SENSORS[plan.cfg.sensor_type].notes(model, plan)
    return [f"{plan.uid}: {note}" for note in notes]
