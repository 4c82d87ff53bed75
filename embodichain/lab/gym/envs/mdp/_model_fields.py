"""`FIELDS`: the model fields that `randomize` may change, as named values and their writers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.engine.api import Engine, EnvIndex
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
    if not hasattr(entity.asset, "is_non_dynamic"):
        message = f"{entity.uid!r} is not a rigid object: it has joints and links"
        raise ConfigError([Problem("entity_cfg.uid", message)])
    if dynamic and entity.asset.is_non_dynamic:
        kind = entity.asset.cfg.body_type
        message = f"{entity.uid!r} is {kind}: {dynamic} means nothing unless body_type: dynamic"
        raise ConfigError([Problem("entity_cfg.uid", message)])


def need_articulation(entity: ResolvedEntity) -> None:
    """Check that an entity has joints.

    Raises:
        ConfigError: If it has none.
    """
    if not hasattr(entity.asset, "parsed"):
        raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} has no joints")])


# -- bodies ----------------------------------------------------------------------------------------


def _bodies(
    entity: ResolvedEntity, what: str = "", moving: bool = True
) -> tuple[list[str], NDArray[np.int64]]:
    """Names and MuJoCo body ids of the picked links (by default all), or of an object."""
    entity.require_links()
    asset = entity.asset
    if not hasattr(asset, "parsed"):
        if moving:
            need_object(entity, what)
        return [entity.uid], np.array([asset.entity.root_body_id], np.int64)
    names = list(entity.link_names or asset.parsed.link_names)
    return names, np.array([asset.body_of(name) for name in names], np.int64)


def _mass(entity: ResolvedEntity, options: Options) -> Values:
    asset, (names, bodies) = entity.asset, _bodies(entity, "its mass")
    mass = asset.engine.model.body_mass
    heavy = np.flatnonzero(mass[bodies] > 0)
    if not len(heavy):
        message = f"links without mass: {', '.join(names)}"
        raise ConfigError([Problem("entity_cfg", message)])
    names, bodies = [names[i] for i in heavy], bodies[heavy]

    def write(ids: NDArray[np.int64]) -> Write:
        def masses(values: Floats, env_ids: EnvIndex | None) -> None:
            values = np.maximum(values, options.min_mass)
            if hasattr(asset, "parsed"):
                asset.write_mass(values, bodies[ids], env_ids, options.recompute_inertia)
            else:
                asset.write_mass(values[:, 0], env_ids, options.recompute_inertia)

        return masses

    default = mass[bodies]
    if _shapes(asset):
        default = np.full(len(default), np.inf)
    return Values(names, default, write, unlimited="each of its shapes has a mass of its own")


def _shapes(asset: Any) -> tuple[str, ...]:
    """Names of the shapes that an object may have, if it has `any_of`."""
    return getattr(asset, "shape_names", ())


def _com(entity: ResolvedEntity, options: Options) -> Values:
    engine, (names, bodies) = entity.asset.engine, _bodies(entity, "its centre of mass")
    if _shapes(entity.asset):
        message = f"{entity.uid!r} has any_of: each of its shapes has a centre of mass of its own"
        raise ConfigError([Problem("entity_cfg.uid", message)])
    columns = (3 * bodies[:, None] + np.arange(3)).reshape(-1)

    def write(ids: NDArray[np.int64]) -> Write:
        def offsets(values: Floats, env_ids: EnvIndex | None) -> None:
            engine.write_model("body_ipos", values, env_ids, columns[ids])
            engine.set_const_later(env_ids)

        return offsets

    axes = [f"{name}.{axis}" for name in names for axis in "xyz"]
    return Values(axes, engine.model.body_ipos.reshape(-1)[columns], write)


def _inertia(entity: ResolvedEntity, options: Options) -> Values:
    asset, (names, bodies) = entity.asset, _bodies(entity, "its inertia")
    engine = asset.engine

    def write(ids: NDArray[np.int64]) -> Write:
        compiled = engine.model.body_mass[bodies[ids]]
        compiled = np.where(compiled > 0, compiled, 1.0)

        def factors(values: Floats, env_ids: EnvIndex | None) -> None:
            if not hasattr(asset, "parsed"):
                asset.write_inertia_scale(values[:, 0], env_ids)
                return
            mass = engine.model_field("body_mass")[:, bodies[ids]]
            mass = mass if env_ids is None else mass[env_ids]
            asset.write_inertia(mass / compiled * values, bodies[ids], env_ids)

        return factors

    return Values(names, np.ones(len(names)), write, 1e-9)


def _scale(entity: ResolvedEntity, options: Options) -> Values:
    need_object(entity)
    entity.require_whole()
    asset, width = entity.asset, 1 if options.same_scale_all_axes else 3
    if _shapes(asset):
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
    axes = np.arange(3) if width == 3 else np.zeros(3, np.int64)
    axes[equal] = axes[equal[0]] if equal else 0

    def factors(values: Floats, env_ids: EnvIndex | None) -> None:
        asset.write_scale(values[:, axes], env_ids, options.fixed_density)

    return Values(list("xyz"[:width]), np.ones(width), lambda ids: factors, 1e-6)


# -- contacts --------------------------------------------------------------------------------------


def _friction(entity: ResolvedEntity, options: Options, axis: int) -> Values:
    """A coefficient of links or objects; geoms of a link with equal compiled values share it.

    Geoms that are picked by name have one each.
    """
    model = entity.asset.engine.model
    geoms = np.asarray(entity.asset.entity.geom_ids, np.int64)
    masks = (model.geom_contype[geoms] | model.geom_conaffinity[geoms])[None]
    variants = entity.asset.entity.variants
    if variants is not None:
        masks = variants.contype | variants.conaffinity
    geoms = geoms[masks.any(axis=0)]
    groups: list[tuple[str, NDArray[np.int64]]] = []
    if entity.kind == "geom":
        picked = np.arange(model.ngeom)[entity.frames.ids]
        one = zip(entity.frame_names, picked, strict=True)
        groups = [(name, np.array([geom], np.int64)) for name, geom in one if geom in geoms]
        if not groups:
            message = f"nothing of these collides: {', '.join(entity.frame_names)}"
            raise ConfigError([Problem("entity_cfg.geom_names", message)])
        return _coefficients(entity.asset.engine, groups, axis)
    owner = model.geom_bodyid[geoms]
    names, bodies = _bodies(entity, moving=False)
    for name, body in zip(names, bodies, strict=True):
        own = geoms[owner == body]
        _, kind = np.unique(model.geom_friction[own], axis=0, return_inverse=True)
        groups += [(name, own[kind.reshape(-1) == k]) for k in np.unique(kind)]
    if not groups:
        message = f"nothing of {entity.uid!r} collides: {', '.join(names)}"
        raise ConfigError([Problem("entity_cfg", message)])
    return _coefficients(entity.asset.engine, groups, axis)


def _coefficients(
    engine: Engine, groups: Sequence[tuple[str, NDArray[np.int64]]], axis: int
) -> Values:
    def write(ids: NDArray[np.int64]) -> Write:
        geoms = np.concatenate([groups[i][1] for i in ids])
        source = np.repeat(np.arange(len(ids)), [len(groups[i][1]) for i in ids])
        order = np.argsort(geoms)
        columns, source = 3 * geoms[order] + axis, source[order]

        def coefficients(values: Floats, env_ids: EnvIndex | None) -> None:
            engine.write_model("geom_friction", values[:, source], env_ids, columns)

        return coefficients

    first = [int(geoms[0]) for _, geoms in groups]
    names = [name for name, _ in groups]
    default = engine.model.geom_friction[first, axis]
    return Values(names, default, write, 0.0, geoms=[own for _, own in groups], axis=axis)


# -- joints ----------------------------------------------------------------------------------------


def _joints(entity: ResolvedEntity, driven: bool) -> NDArray[np.int64]:
    """Indices of the picked joints, which must all have a drive if `driven`."""
    need_articulation(entity)
    entity.require_whole()
    asset = entity.asset
    joints = np.asarray(entity.joint_ids, np.int64)
    wrong = joints[np.asarray(asset.entity.actuator_ids, np.int64)[joints] < 0]
    if driven and (len(wrong) or not len(joints)):
        names = ", ".join(asset.parsed.joint_names[i] for i in wrong) or "(no joint)"
        message = f"joints of {entity.uid!r} without a drive: {names}"
        hint = "for motors and the like of an MJCF file use randomize_actuator_strength"
        raise ConfigError([Problem("entity_cfg", message, hint)])
    return joints


def _drive(entity: ResolvedEntity, options: Options, name: str, driven: bool = False) -> Values:
    """A property of drives or joints; the name is that of `Drives.put`."""
    asset, joints = entity.asset, _joints(entity, driven)

    def write(ids: NDArray[np.int64]) -> Write:
        return lambda values, env_ids: asset.drives.write(name, values, env_ids, joints[ids])

    names = [asset.parsed.joint_names[i] for i in joints]
    compiled = np.asarray(getattr(asset.parsed, name), np.float64)[joints]
    return Values(names, compiled, write, 0.0, "these have no limit")


def _limit(entity: ResolvedEntity, options: Options, side: int) -> Values:
    asset, joints = entity.asset, _joints(entity, driven=False)

    def write(ids: NDArray[np.int64]) -> Write:
        return lambda values, env_ids: asset.drives.write_limit(side, values, env_ids, joints[ids])

    names = [asset.parsed.joint_names[i] for i in joints]
    compiled = np.asarray(asset.parsed.qpos_limits, np.float64)[joints]
    compiled = np.where(np.isfinite(compiled).all(axis=1), compiled[:, side], np.inf)
    return Values(names, compiled, write, None, "these joints have no limits", needs_default=True)


def _strength(entity: ResolvedEntity, options: Options) -> Values:
    """Factors of drives, and of a file's own actuators on the picked joints."""
    need_articulation(entity)
    asset = entity.asset
    index, model = asset.entity, asset.engine.model
    joints = np.asarray(entity.joint_ids, np.int64)
    driven = joints[np.asarray(index.actuator_ids, np.int64)[joints] >= 0]
    others = np.setdiff1d(index.own_actuator_ids, index.actuator_ids)
    own = _own_actuators(model, others, np.asarray(index.dof_adr, np.int64)[joints])
    names = [asset.parsed.joint_names[i] for i in driven]
    names += [model.actuator(i).name or f"actuator {i}" for i in own]
    if not names:
        message = f"no actuator drives: {', '.join(entity.joint_names)}"
        raise ConfigError([Problem("entity_cfg", message)])

    def write(ids: NDArray[np.int64]) -> Write:
        drives, rest = driven[ids[ids < len(driven)]], own[ids[ids >= len(driven)] - len(driven)]
        parts = _proportional(model, rest) if len(rest) else []

        def factors(values: Floats, env_ids: EnvIndex | None) -> None:
            if len(drives):
                asset.drives.write("strength", values[:, : len(drives)], env_ids, drives)
            factor = values[:, len(drives) :]
            for name, columns, compiled, source in parts:
                asset.engine.write_model(name, compiled * factor[:, source], env_ids, columns)

        return factors

    return Values(names, np.ones(len(names)), write, 0.0)


_Part = tuple[str, NDArray[np.int64], "Floats", NDArray[np.int64]]
"""A model field, its columns, their compiled values, and the index of each one's factor."""


def _proportional(model: mujoco.MjModel, actuators: NDArray[np.int64]) -> list[_Part]:
    """The model fields that the actuators' forces are proportional to."""

    def part(field: str, which: NDArray[np.int64], used: int) -> _Part:
        table = getattr(model, field)
        columns = (table.shape[1] * actuators[which, None] + np.arange(used)).reshape(-1)
        return field, columns, table.reshape(-1)[columns].copy(), np.repeat(which, used)

    every = np.arange(len(actuators))
    parts = [part("actuator_gainprm", every, 3), part("actuator_biasprm", every, 3)]
    limited = np.flatnonzero(model.actuator_forcelimited[actuators])
    return [*parts, part("actuator_forcerange", limited, 2)] if len(limited) else parts


def _own_actuators(
    model: mujoco.MjModel, actuators: NDArray[np.int64], dofs: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The file's actuators on the joints of these dofs; forces must be linear in the parameters.

    Raises:
        ConfigError: If an actuator has another force law, such as a muscle's.
    """
    joints = model.dof_jntid[dofs]
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    linear_gain = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
    linear_bias = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    found = [
        int(i)
        for i in actuators
        if model.actuator_trntype[i] in kinds and model.actuator_trnid[i, 0] in joints
    ]
    for i in found:
        gain, bias = model.actuator_gaintype[i], model.actuator_biastype[i]
        if gain not in linear_gain or bias not in linear_bias:
            message = f"{model.actuator(i).name!r} has a force law that has no strength to scale"
            raise ConfigError([Problem("entity_cfg", message)])
    return np.asarray(found, np.int64)


# -- the scene -------------------------------------------------------------------------------------


def _gravity(engine: Engine) -> Values:
    def write(ids: NDArray[np.int64]) -> Write:
        return lambda values, env_ids: engine.write_model("opt.gravity", values, env_ids)

    return Values(list("xyz"), engine.model.opt.gravity, write)


def _ground(engine: Engine, axis: int) -> Values:
    model = engine.model
    names = [model.geom(i).name for i in range(model.ngeom)]
    if GROUND not in names:
        message = "there is no ground plane in this scene"
        raise ConfigError([Problem("", message, "the simulation's ground_plane is off")])
    geoms = np.array([names.index(GROUND)], np.int64)
    return _coefficients(engine, [("ground", geoms)], axis)


FIELDS: dict[str, Field] = {
    "scale": Field(_scale, "scale", fixed=True),
    "mass": Field(_mass),
    "com": Field(_com, "add", fixed=True),
    "inertia": Field(_inertia, "scale", fixed=True),
    "friction": Field(partial(_friction, axis=0)),
    "torsional_friction": Field(partial(_friction, axis=1)),
    "rolling_friction": Field(partial(_friction, axis=2)),
    "stiffness": Field(partial(_drive, name="stiffness", driven=True)),
    "damping": Field(partial(_drive, name="damping", driven=True)),
    "effort_limit": Field(partial(_drive, name="max_effort", driven=True)),
    "joint_friction": Field(partial(_drive, name="friction")),
    "armature": Field(partial(_drive, name="armature")),
    "joint_damping": Field(partial(_drive, name="joint_damping")),
    "lower_limit": Field(partial(_limit, side=0)),
    "upper_limit": Field(partial(_limit, side=1)),
    "strength": Field(_strength, "scale", fixed=True),
}
"""Fields of an entity, in the order in which they are drawn and written."""
SCENE_FIELDS: dict[str, tuple[Callable[[Engine], Values], Operation]] = {
    "friction": (partial(_ground, axis=0), "abs"),
    "torsional_friction": (partial(_ground, axis=1), "abs"),
    "rolling_friction": (partial(_ground, axis=2), "abs"),
    "gravity": (_gravity, "add"),
}
"""Fields of the scene and its ground plane: values and the operation if none is given."""
