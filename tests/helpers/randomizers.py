"""One case for every event that randomizes model fields: parameters, and where its values stand."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

ARM = {"entity_cfg": {"uid": "ur10"}}
CUBE = {"entity_cfg": {"uid": "cube"}}
FORCE_LIMIT = 100.0


@dataclass(frozen=True)
class Case:
    """A randomizer.

    Attributes:
        func: Its name.
        params: Parameters without the range.
        range_key: The parameter that gives the range.
        low, high: The range.
        values: Reads what was drawn, (N, k), from the engine's model fields, in the range's unit.
        neutral: The range that must change nothing (with `neutral_params`).
        box: Whether the range is a box of three axes.
        distributions: Those it takes.
    """

    func: str
    range_key: str
    low: float
    high: float
    values: Callable[[Any], np.ndarray]
    params: dict[str, Any] = field(default_factory=dict)
    neutral: float = 1.0
    neutral_params: dict[str, Any] = field(default_factory=lambda: {"operation": "scale"})
    box: bool = False
    distributions: Sequence[str] = ("uniform", "log_uniform", "gaussian")
    id: str = ""

    def given(self, low: float, high: float) -> Any:
        return [[low] * 3, [high] * 3] if self.box else [low, high]

    def event(self, distribution: str = "uniform", mode: str = "reset", **more: Any) -> Any:
        from embodichain.lab.gym.envs.cfg import EventCfg

        given = {self.range_key: self.given(self.low, self.high), "distribution": distribution}
        return EventCfg(func=self.func, mode=mode, params={**self.params, **given}, **more)

    def neutral_event(self, mode: str = "reset") -> Any:
        from embodichain.lab.gym.envs.cfg import EventCfg

        given = {self.range_key: self.given(self.neutral, self.neutral), **self.neutral_params}
        return EventCfg(func=self.func, mode=mode, params={**self.params, **given})


def ratio(name: str, pick: Callable[[Any], Sequence[int]]) -> Callable[[Any], np.ndarray]:
    """Columns of a field over the compiled ones."""

    def read(env: Any) -> np.ndarray:
        columns = np.asarray(pick(env))
        engine = env.sim.engine
        return engine.model_field(name)[:, columns] / default(engine.model, name)[columns]

    return read


def absolute(
    name: str, pick: Callable[[Any], Sequence[int]], less: bool = False, sign: float = 1.0
) -> Any:
    """Columns of a field times `sign`, or their difference to the compiled ones."""

    def read(env: Any) -> np.ndarray:
        columns = np.asarray(pick(env))
        engine = env.sim.engine
        found = sign * engine.model_field(name)[:, columns].astype(float)
        return found - default(engine.model, name)[columns] if less else found

    return read


def default(model: Any, name: str) -> np.ndarray:
    owner: Any = model
    for part in name.split("."):
        owner = getattr(owner, part)
    return np.asarray(owner).reshape(-1)


def cube(env: Any) -> int:
    return env.sim.get_asset("cube").entity.root_body_id


def links(env: Any) -> list[int]:
    bodies = env.robot.entity.body_ids
    return [int(b) for b in bodies if env.sim.engine.model.body_mass[b] > 0]


def dofs(env: Any) -> list[int]:
    return list(env.robot.entity.dof_adr)


def drives(width: int, at: int = 0) -> Callable[[Any], list[int]]:
    return lambda env: [width * int(a) + at for a in env.robot.entity.actuator_ids]


def ground(env: Any) -> int:
    return int(env.sim.engine.model.geom("default_plane").id)


def cube_geom(env: Any) -> int:
    return int(env.sim.get_asset("cube").entity.geom_ids[0])


def arm_limits(side: int) -> Callable[[Any], list[int]]:
    def pick(env: Any) -> list[int]:
        model = env.sim.engine.model
        return [2 * int(model.dof_jntid[d]) + side for d in dofs(env)]

    return pick


NOTHING: dict[str, Any] = {}
ADD = {"operation": "add"}
SCALE = {"operation": "scale"}
PLAIN = ("uniform", "gaussian")  # a logarithm needs positive bounds

CASES = [
    Case("randomize_rigid_object_mass", "mass_range", 0.5, 2.0,
         absolute("body_mass", lambda e: [cube(e)]), CUBE),
    Case("randomize_rigid_object_mass", "mass_range", -0.5, 0.5,
         absolute("body_mass", lambda e: [cube(e)], less=True), {**CUBE, "relative": True},
         neutral=0.0, neutral_params=NOTHING, distributions=PLAIN, id="relative mass"),
    Case("randomize_articulation_mass", "mass_range", 0.8, 1.2,
         ratio("body_inertia", lambda e: [3 * b for b in links(e)]), {**ARM, **SCALE}),
    Case("randomize_rigid_object_center_of_mass", "com_pos_offset_range", -0.01, 0.02,
         absolute("body_ipos", lambda e: range(3 * cube(e), 3 * cube(e) + 3), less=True), CUBE,
         neutral=0.0, neutral_params=NOTHING, box=True, distributions=PLAIN),
    Case("randomize_link_com", "com_range", -0.03, 0.02,
         absolute("body_ipos", lambda e: [3 * b + i for b in links(e) for i in (0, 1, 2)],
                  less=True),
         ARM, neutral=0.0, neutral_params=NOTHING, box=True, distributions=PLAIN),
    Case("randomize_link_inertia", "inertia_range", 0.7, 1.3,
         ratio("body_inertia", lambda e: [3 * b + 2 for b in links(e)]), ARM,
         neutral_params=NOTHING),
    Case("randomize_link_inertia", "inertia_range", 0.7, 1.3,
         ratio("body_inertia", lambda e: [3 * cube(e)]), CUBE,
         neutral_params=NOTHING, id="inertia of an object"),
    Case("randomize_rigid_body_material", "friction_range", 0.3, 1.2,
         absolute("geom_friction", lambda e: [3 * cube_geom(e)]), CUBE),
    Case("randomize_rigid_body_material", "rolling_range", 0.5, 1.5,
         ratio("geom_friction", lambda e: [3 * cube_geom(e) + 2]), {**CUBE, **SCALE},
         id="rolling friction"),
    Case("randomize_ground_material", "torsional_range", 0.01, 0.05,
         absolute("geom_friction", lambda e: [3 * ground(e) + 1])),
    Case("randomize_actuator_gains", "stiffness_range", 0.8, 1.2,
         ratio("actuator_gainprm", drives(10)), {**ARM, **SCALE}),
    Case("randomize_actuator_gains", "damping_range", 800.0, 1200.0,
         absolute("actuator_biasprm", drives(10, 2), sign=-1), ARM, id="damping of drives"),
    Case("randomize_effort_limits", "effort_limit_range", 50.0, 150.0,
         absolute("actuator_forcerange", drives(2, 1)), ARM),
    Case("randomize_joint_parameters", "friction_range", 0.5, 2.0,
         absolute("dof_frictionloss", dofs), ARM, neutral_params=SCALE),
    Case("randomize_joint_parameters", "armature_range", 0.05, 0.1,
         absolute("dof_armature", dofs), ARM, id="armature"),
    Case("randomize_joint_parameters", "damping_range", 1.0, 100.0,
         absolute("dof_damping", dofs, less=True), {**ARM, **ADD},
         neutral=0.0, neutral_params=NOTHING, distributions=PLAIN, id="damping of joints"),
    Case("randomize_joint_parameters", "lower_limit_range", 0.0, 0.2,
         absolute("jnt_range", arm_limits(0), less=True), {**ARM, **ADD},
         neutral=0.0, neutral_params=NOTHING, distributions=PLAIN, id="lower limits"),
    Case("randomize_joint_parameters", "upper_limit_range", 0.9, 1.0,
         ratio("jnt_range", arm_limits(1)), {**ARM, **SCALE}, id="upper limits"),
    Case("randomize_actuator_strength", "strength_range", 0.6, 1.1,
         ratio("actuator_biasprm", drives(10, 1)), ARM, neutral_params=NOTHING),
    Case("randomize_physics_scene_gravity", "gravity_range", -0.5, 0.4,
         absolute("opt.gravity", lambda e: range(3), less=True), neutral=0.0,
         neutral_params=NOTHING, box=True, distributions=PLAIN),
    Case("randomize_rigid_object_scale", "scale_factor_range", 0.8, 1.3,
         ratio("geom_size", lambda e: [3 * cube_geom(e)]), CUBE, neutral_params=NOTHING),
    Case("randomize", "mass", 0.5, 2.0, absolute("body_mass", lambda e: [cube(e)]), CUBE),
    Case("randomize", "friction", 0.5, 1.5, ratio("geom_friction", lambda e: [3 * ground(e)]),
         SCALE, neutral_params=NOTHING, id="friction of the ground"),
    Case("randomize_rigid_objects_scale", "scale_factor_range", 0.8, 1.3,
         ratio("geom_size", lambda e: [3 * cube_geom(e)]),
         {"entity_cfgs": [{"uid": "cube"}, {"uid": "goal"}]}, neutral_params=NOTHING),
]  # fmt: skip
IDS = [case.id or case.func for case in CASES]
