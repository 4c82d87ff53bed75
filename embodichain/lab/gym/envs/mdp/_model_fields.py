"""`FIELDS`: the model fields that `randomize` may change, as named values and their writers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.objects.rigid_object import RigidObject
    from embodichain.utils.array_types import Floats
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = [
    "FIELDS",
    "SCENE_FIELDS",
    "Field",
    "Operation",
    "Options",
    "Values",
    "Write",
    "need_articulation",
    "need_object",
]

Operation = Literal["add", "scale", "abs"]
"""How a drawn number changes the compiled one: it is added, multiplies it, or replaces it."""
Write = Callable[["Floats", "EnvIndex | None"], None]
"""Writes values (n, m) in the environments given, or in all."""
GROUND = "default_plane"


@dataclass(frozen=True, eq=False)
class Values:
    """A field of one entity: k named values, one for each body, joint or geom.

    Attributes:
        names: Names of the values, for ranges by name and for messages.
        default: (k,) compiled values.
        write: Returns the function that writes the values (n, m) with indices (m,).
        lowest: The smallest valid value; None is any.
        unlimited: Why a default may be infinite, for messages.
        needs_default: Whether an infinite default is an error for every operation.
        geoms: (k,) geoms of which it is a friction; empty if it is none.
        axis: 0 is sliding, 1 torsional, 2 rolling friction.
    """

    names: Sequence[str]
    default: Floats
    write: Callable[[NDArray[np.int64]], Write]
    lowest: float | None = None
    unlimited: str = ""
    needs_default: bool = False
    geoms: Sequence[NDArray[np.int64]] = ()
    axis: int = 0


@dataclass(frozen=True)
class Options:
    """The options of `randomize` besides ranges; described there."""

    recompute_inertia: bool
    min_mass: float
    same_scale_all_axes: bool
    fixed_density: bool


@dataclass(frozen=True)
class Field:
    """A field by name.

    Attributes:
        values: Returns an entity's values.
        operation: The default operation.
        fixed: Whether no other operation is allowed.
    """

    values: Callable[[ResolvedEntity, Options], Values]
    operation: Operation = "abs"
    fixed: bool = False


def need_object(entity: ResolvedEntity, dynamic: str = "") -> None:
    """Check that an entity is a rigid object, and dynamic if `dynamic` names a reason.

    Raises:
        ConfigError: If it is not.
    """
    if entity.is_articulation:
        message = f"{entity.uid!r} is not a rigid object: it has joints and links"
        raise ConfigError([Problem("entity_cfg.uid", message)])
    rigid_object = entity.rigid_object
    if dynamic and rigid_object.is_non_dynamic:
        kind = rigid_object.cfg.body_type
        message = f"{entity.uid!r} is {kind}: {dynamic} means nothing unless body_type: dynamic"
        raise ConfigError([Problem("entity_cfg.uid", message)])


def need_articulation(entity: ResolvedEntity) -> None:
    """Check that an entity has joints.

    Raises:
        ConfigError: If it has none.
    """
    if not entity.is_articulation:
        raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} has no joints")])


# -- bodies ----------------------------------------------------------------------------------------


def _links_or_object(
    entity: ResolvedEntity, what: str = "", moving: bool = True
) -> tuple[list[str], NDArray[np.int64]]:
    """Names and MuJoCo body ids of the picked links (by default all), or of an object."""
    entity.require_links()
    if not entity.is_articulation:
        if moving:
            need_object(entity, what)
        return [entity.uid], np.array([entity.asset.index.root_body_id], np.int64)
    articulation = entity.articulation
    names = list(entity.link_names or articulation.parsed.link_names)
    return names, np.array([articulation.body_of(name) for name in names], np.int64)


def _mass_values(entity: ResolvedEntity, options: Options) -> Values:
    asset = entity.asset
    names, bodies = _links_or_object(entity, "its mass")
    mass = asset.engine.model.body_mass
    has_mass = np.flatnonzero(mass[bodies] > 0)
    if not len(has_mass):
        message = f"links without mass: {', '.join(names)}"
        raise ConfigError([Problem("entity_cfg", message)])
    names = [names[i] for i in has_mass]
    bodies = bodies[has_mass]

    def make_write(ids: NDArray[np.int64]) -> Write:
        def write_masses(values: Floats, env_ids: EnvIndex | None) -> None:
            values = np.maximum(values, options.min_mass)
            scales_inertia = options.recompute_inertia
            if entity.is_articulation:
                entity.articulation.write_mass(values, bodies[ids], env_ids, scales_inertia)
            else:
                entity.rigid_object.write_mass(values[:, 0], env_ids, scales_inertia)

        return write_masses

    default = mass[bodies]
    if _shape_names(asset):
        default = np.full(len(default), np.inf)
    return Values(names, default, make_write, unlimited="each of its shapes has a mass of its own")


def _shape_names(asset: Articulation | RigidObject) -> tuple[str, ...]:
    """Names of the shapes that an object may have, if it has `any_of`."""
    return getattr(asset, "shape_names", ())


def _com_values(entity: ResolvedEntity, options: Options) -> Values:
    engine = entity.asset.engine
    names, bodies = _links_or_object(entity, "its centre of mass")
    if _shape_names(entity.asset):
        message = f"{entity.uid!r} has any_of: each of its shapes has a centre of mass of its own"
        raise ConfigError([Problem("entity_cfg.uid", message)])
    columns = (3 * bodies[:, None] + np.arange(3)).reshape(-1)

    def make_write(ids: NDArray[np.int64]) -> Write:
        def write_positions(values: Floats, env_ids: EnvIndex | None) -> None:
            engine.write_model("body_ipos", values, env_ids, columns[ids])
            engine.set_const_later(env_ids)

        return write_positions

    axes = [f"{name}.{axis}" for name in names for axis in "xyz"]
    return Values(axes, engine.model.body_ipos.reshape(-1)[columns], make_write)


def _inertia_values(entity: ResolvedEntity, options: Options) -> Values:
    engine = entity.asset.engine
    names, bodies = _links_or_object(entity, "its inertia")

    def make_write(ids: NDArray[np.int64]) -> Write:
        compiled_mass = engine.model.body_mass[bodies[ids]]
        compiled_mass = np.where(compiled_mass > 0, compiled_mass, 1.0)

        def write_factors(values: Floats, env_ids: EnvIndex | None) -> None:
            if not entity.is_articulation:
                entity.rigid_object.write_inertia_scale(values[:, 0], env_ids)
                return
            mass = engine.model_field("body_mass")[:, bodies[ids]]
            if env_ids is not None:
                mass = mass[env_ids]
            inertia_scale = mass / compiled_mass * values
            entity.articulation.write_inertia(inertia_scale, bodies[ids], env_ids)

        return write_factors

    return Values(names, np.ones(len(names)), make_write, lowest=1e-9)


def _scale_values(entity: ResolvedEntity, options: Options) -> Values:
    need_object(entity)
    entity.require_whole()
    asset = entity.rigid_object
    width = 1 if options.same_scale_all_axes else 3
    if _shape_names(asset):
        message = f"{entity.uid!r} has any_of: list shapes of several sizes there"
        raise ConfigError([Problem("entity_cfg.uid", message)])
    try:
        solid = asset.solid
    except ValueError as error:
        raise ConfigError([Problem("entity_cfg.uid", str(error))]) from error
    equal = list(solid.equal_axes)
    if width == 3 and len(equal) == 3:
        message = f"{solid.uid!r} is a {solid.kind}: its axes have one scale"
        raise ConfigError([Problem("same_scale_all_axes", message)])
    # The drawn column that scales each axis: x and y of a capsule share one.
    drawn_columns = np.arange(3) if width == 3 else np.zeros(3, np.int64)
    if equal:
        drawn_columns[equal] = drawn_columns[equal[0]]

    def write_factors(values: Floats, env_ids: EnvIndex | None) -> None:
        asset.write_scale(values[:, drawn_columns], env_ids, options.fixed_density)

    names = list("xyz"[:width])
    return Values(names, np.ones(width), write=lambda ids: write_factors, lowest=1e-6)


# -- contacts --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _FrictionGroup:
    """Geoms that get the same drawn coefficient.

    Attributes:
        name: The link, object or geom.
        geoms: (g,) MuJoCo ids.
    """

    name: str
    geoms: NDArray[np.int64]


def _friction_values(entity: ResolvedEntity, options: Options, axis: int) -> Values:
    """A coefficient of links or objects; geoms of a link with equal compiled values share it.

    Geoms that are picked by name have one each.
    """
    engine = entity.asset.engine
    geoms = _colliding_geoms(entity)
    groups: list[_FrictionGroup] = []
    if entity.kind == "geom":
        picked = np.arange(engine.model.ngeom)[entity.frames.ids]
        for name, geom in zip(entity.frame_names, picked, strict=True):
            if geom in geoms:
                groups.append(_FrictionGroup(name, np.array([geom], np.int64)))
        if not groups:
            message = f"none of these collides: {', '.join(entity.frame_names)}"
            raise ConfigError([Problem("entity_cfg.geom_names", message)])
        return _coefficients(engine, groups, axis)

    body_of_geom = engine.model.geom_bodyid[geoms]
    names, bodies = _links_or_object(entity, moving=False)
    for name, body in zip(names, bodies, strict=True):
        body_geoms = geoms[body_of_geom == body]
        frictions = engine.model.geom_friction[body_geoms]
        _, kind = np.unique(frictions, axis=0, return_inverse=True)
        kind = kind.reshape(-1)
        groups += [_FrictionGroup(name, body_geoms[kind == k]) for k in np.unique(kind)]
    if not groups:
        message = f"no part of {entity.uid!r} collides: {', '.join(names)}"
        raise ConfigError([Problem("entity_cfg", message)])
    return _coefficients(engine, groups, axis)


def _colliding_geoms(entity: ResolvedEntity) -> NDArray[np.int64]:
    """The geoms of an entity that collide, with any of its shapes if it has several."""
    model = entity.asset.engine.model
    geoms = np.asarray(entity.asset.index.geom_ids, np.int64)
    variants = entity.asset.index.variants
    if variants is None:
        return geoms[(model.geom_contype[geoms] | model.geom_conaffinity[geoms]) != 0]
    return geoms[(variants.contype | variants.conaffinity).any(axis=0)]


def _coefficients(engine: Engine, groups: Sequence[_FrictionGroup], axis: int) -> Values:
    """One coefficient for each group of geoms."""

    def make_write(ids: NDArray[np.int64]) -> Write:
        drawn_groups = [groups[i] for i in ids]
        geoms = np.concatenate([group.geoms for group in drawn_groups])
        source = np.repeat(np.arange(len(ids)), [len(group.geoms) for group in drawn_groups])
        order = np.argsort(geoms)
        columns = 3 * geoms[order] + axis
        source = source[order]

        def write_coefficients(values: Floats, env_ids: EnvIndex | None) -> None:
            engine.write_model("geom_friction", values[:, source], env_ids, columns)

        return write_coefficients

    first_geoms = [int(group.geoms[0]) for group in groups]
    return Values(
        names=[group.name for group in groups],
        default=engine.model.geom_friction[first_geoms, axis],
        write=make_write,
        lowest=0.0,
        geoms=[group.geoms for group in groups],
        axis=axis,
    )


# -- joints ----------------------------------------------------------------------------------------


def _picked_joints(entity: ResolvedEntity, driven: bool) -> NDArray[np.int64]:
    """Indices of the picked joints, which must all have a drive if `driven`."""
    need_articulation(entity)
    entity.require_whole()
    asset = entity.articulation
    joints = np.asarray(entity.joint_ids, np.int64)
    undriven = joints[np.asarray(asset.index.actuator_ids, np.int64)[joints] < 0]
    if driven and (len(undriven) or not len(joints)):
        names = ", ".join(asset.parsed.joint_names[i] for i in undriven) or "(no joint)"
        message = f"joints of {entity.uid!r} without a drive: {names}"
        hint = "for motors and the like of an MJCF file use randomize_actuator_strength"
        raise ConfigError([Problem("entity_cfg", message, hint)])
    return joints


def _joint_values(
    entity: ResolvedEntity, options: Options, name: str, driven: bool = False
) -> Values:
    """A property of drives or joints; the name is that of `Drives.put`."""
    asset = entity.articulation
    joints = _picked_joints(entity, driven)

    def make_write(ids: NDArray[np.int64]) -> Write:
        return lambda values, env_ids: asset.drives.write(name, values, env_ids, joints[ids])

    return Values(
        names=[asset.parsed.joint_names[i] for i in joints],
        default=np.asarray(getattr(asset.parsed, name), np.float64)[joints],
        write=make_write,
        lowest=0.0,
        unlimited="these have no limit",
    )


def _limit_values(entity: ResolvedEntity, options: Options, side: Literal[0, 1]) -> Values:
    """The lower (0) or upper (1) position limits of joints."""
    asset = entity.articulation
    joints = _picked_joints(entity, driven=False)

    def make_write(ids: NDArray[np.int64]) -> Write:
        return lambda values, env_ids: asset.drives.write_limit(side, values, env_ids, joints[ids])

    limits = np.asarray(asset.parsed.qpos_limits, np.float64)[joints]
    is_limited = np.isfinite(limits).all(axis=1)
    return Values(
        names=[asset.parsed.joint_names[i] for i in joints],
        default=np.where(is_limited, limits[:, side], np.inf),
        write=make_write,
        unlimited="these joints have no limits",
        needs_default=True,
    )


def _strength_values(entity: ResolvedEntity, options: Options) -> Values:
    """Factors of drives, and of a file's own actuators on the picked joints."""
    need_articulation(entity)
    asset = entity.articulation
    index = asset.index
    model = asset.engine.model
    joints = np.asarray(entity.joint_ids, np.int64)
    driven_joints = joints[np.asarray(index.actuator_ids, np.int64)[joints] >= 0]
    other_actuators = np.setdiff1d(index.own_actuator_ids, index.actuator_ids)
    dofs = np.asarray(index.dof_adr, np.int64)[joints]
    file_actuators = _file_actuators(model, other_actuators, dofs)
    names = [asset.parsed.joint_names[i] for i in driven_joints]
    names += [model.actuator(i).name or f"actuator {i}" for i in file_actuators]
    if not names:
        message = f"no actuator drives: {', '.join(entity.joint_names)}"
        raise ConfigError([Problem("entity_cfg", message)])

    def make_write(ids: NDArray[np.int64]) -> Write:
        # Values of drives come first, then those of actuators.
        drive_count = len(driven_joints)
        drives = driven_joints[ids[ids < drive_count]]
        actuators = file_actuators[ids[ids >= drive_count] - drive_count]
        fields = _force_fields(model, actuators)

        def write_factors(values: Floats, env_ids: EnvIndex | None) -> None:
            if len(drives):
                asset.drives.write("strength", values[:, : len(drives)], env_ids, drives)
            factors = values[:, len(drives) :]
            for field in fields:
                scaled = field.compiled * factors[:, field.factors]
                asset.engine.write_model(field.name, scaled, env_ids, field.columns)

        return write_factors

    return Values(names, np.ones(len(names)), make_write, lowest=0.0)


@dataclass(frozen=True)
class _ForceField:
    """A model field that the forces of actuators are proportional to.

    Attributes:
        name: Its name.
        columns: (c,) the columns of these actuators.
        compiled: (c,) their values in the model.
        factors: (c,) the index of the actuator, whose factor multiplies the value.
    """

    name: str
    columns: NDArray[np.int64]
    compiled: Floats
    factors: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        name: str,
        actuators: NDArray[np.int64],
        chosen: NDArray[np.int64],
        width: int,
    ) -> _ForceField:
        """Read the first `width` columns of the chosen ones, by index, of some actuators."""
        table = getattr(model, name)
        columns = (table.shape[1] * actuators[chosen, None] + np.arange(width)).reshape(-1)
        compiled = table.reshape(-1)[columns].copy()
        return cls(name, columns, compiled, np.repeat(chosen, width))


def _force_fields(model: mujoco.MjModel, actuators: NDArray[np.int64]) -> list[_ForceField]:
    """The model fields that the actuators' forces are proportional to."""
    if not len(actuators):
        return []
    every = np.arange(len(actuators))
    limited = np.flatnonzero(model.actuator_forcelimited[actuators])
    fields = [
        _ForceField.of(model, "actuator_gainprm", actuators, every, width=3),
        _ForceField.of(model, "actuator_biasprm", actuators, every, width=3),
    ]
    if len(limited):
        fields.append(_ForceField.of(model, "actuator_forcerange", actuators, limited, width=2))
    return fields


def _file_actuators(
    model: mujoco.MjModel, actuators: NDArray[np.int64], dofs: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The file's actuators on the joints of these dofs; forces must be linear in the parameters.

    Raises:
        ConfigError: If an actuator has another force law, such as a muscle's.
    """
    joints = model.dof_jntid[dofs]
    joint_transmissions = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    linear_gains = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
    linear_biases = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    of_joints: list[int] = []
    for actuator in actuators.tolist():
        if model.actuator_trntype[actuator] not in joint_transmissions:
            continue
        if model.actuator_trnid[actuator, 0] not in joints:
            continue
        has_linear_gain = model.actuator_gaintype[actuator] in linear_gains
        has_linear_bias = model.actuator_biastype[actuator] in linear_biases
        if not (has_linear_gain and has_linear_bias):
            name = model.actuator(actuator).name
            message = f"{name!r} has a force law that has no strength to scale"
            raise ConfigError([Problem("entity_cfg", message)])
        of_joints.append(actuator)
    return np.asarray(of_joints, np.int64)


# -- the scene -------------------------------------------------------------------------------------


def _gravity_values(engine: Engine) -> Values:
    def make_write(ids: NDArray[np.int64]) -> Write:
        return lambda values, env_ids: engine.write_model("opt.gravity", values, env_ids)

    return Values(list("xyz"), engine.model.opt.gravity, make_write)


def _ground_values(engine: Engine, axis: int) -> Values:
    model = engine.model
    names = [model.geom(i).name for i in range(model.ngeom)]
    if GROUND not in names:
        message = "there is no ground plane in this scene"
        raise ConfigError([Problem("", message, "the simulation's ground_plane is off")])
    ground = _FrictionGroup("ground", np.array([names.index(GROUND)], np.int64))
    return _coefficients(engine, [ground], axis)


FIELDS: dict[str, Field] = {
    "scale": Field(_scale_values, "scale", fixed=True),
    "mass": Field(_mass_values),
    "com": Field(_com_values, "add", fixed=True),
    "inertia": Field(_inertia_values, "scale", fixed=True),
    "friction": Field(partial(_friction_values, axis=0)),
    "torsional_friction": Field(partial(_friction_values, axis=1)),
    "rolling_friction": Field(partial(_friction_values, axis=2)),
    "stiffness": Field(partial(_joint_values, name="stiffness", driven=True)),
    "damping": Field(partial(_joint_values, name="damping", driven=True)),
    "effort_limit": Field(partial(_joint_values, name="max_effort", driven=True)),
    "joint_friction": Field(partial(_joint_values, name="friction")),
    "armature": Field(partial(_joint_values, name="armature")),
    "joint_damping": Field(partial(_joint_values, name="joint_damping")),
    "lower_limit": Field(partial(_limit_values, side=0)),
    "upper_limit": Field(partial(_limit_values, side=1)),
    "strength": Field(_strength_values, "scale", fixed=True),
}
"""Fields of an entity, in the order in which they are drawn and written."""
SCENE_FIELDS: dict[str, tuple[Callable[[Engine], Values], Operation]] = {
    "friction": (partial(_ground_values, axis=0), "abs"),
    "torsional_friction": (partial(_ground_values, axis=1), "abs"),
    "rolling_friction": (partial(_ground_values, axis=2), "abs"),
    "gravity": (_gravity_values, "add"),
}
"""Fields of the scene and its ground plane: values and the operation if none is given."""
