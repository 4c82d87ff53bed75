"""EmbodiChain's events that write attributes and poses into dictionaries on the environment."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from embodichain.compat.terms._targets import asset_of, get_or_create
from embodichain.lab.gym.envs.cfg import EnvCfg, SceneEntityCfg
from embodichain.lab.gym.envs.managers.param_types import Body, Whole
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.aliases import alias, register_aliases
from embodichain.lab.gym.envs.managers.terms.registry import import_object, register_term
from embodichain.utils.arrays import tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import (
    matrix_to_pose,
    pose_to_matrix,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
)
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = ["PrepareExtraAttr", "RegisterInfoToEnv"]

EXTRA_ATTRS = "extra_attrs"
"""Attribute of the environment: uid -> name -> value."""
Relative = bool | str | list[str]
_NOT_IMPORTED = "would be imported, which is not done for this config"
_UPDATE_STEPS = 100
"""Physics steps of `sim_update`, as in EmbodiChain."""


@dataclass
class ExtraAttr:
    """One attribute of some entities.

    Attributes:
        name: Its name.
        mode: `static` takes `value`; `callable` calls `func_name`.
        value: Anything.
        entity_cfg: The entity; or
        entity_uids: entities, or `all_objects` or `all_robots`.
        func_name: A method of the entity's handle, or ``package.module:function``, which gets
            (env, env_ids, handle) first.
        func_kwargs: Further arguments.
    """

    __pydantic_config__ = {"extra": "forbid"}

    name: str
    mode: Literal["static", "callable"] = "static"
    value: Any = None
    entity_cfg: SceneEntityCfg | None = None
    entity_uids: str | list[str] | None = None
    func_name: str | None = None
    func_kwargs: dict[str, Any] = field(default_factory=dict)


@dataclass
class PoseParams:
    """The parameters of `register_entity_pose`, which describes them."""

    __pydantic_config__ = {"extra": "forbid"}

    compute_relative: Relative = "all_robots"
    compute_pose_object_to_arena: bool = True
    to_matrix: bool = True


@dataclass
class Registry:
    """The values that `register_info_to_env` registers for one entity."""

    __pydantic_config__ = {"extra": "forbid"}

    entity_cfg: SceneEntityCfg | ResolvedEntity
    attrs: list[str] = field(default_factory=list)
    prefix: bool = True
    pose_register_params: PoseParams | None = None


def _uids_of(env: TermContext, selection: Relative, path: str) -> list[str]:
    """The entities of a selection.

    Args:
        env: The environment.
        selection: ``all_objects`` (rigid objects and articulations), ``all_robots``, a name or a
            list of names; true is every entity, false is none.
        path: The parameter that has it, for messages.

    Raises:
        ConfigError: If an entity does not exist; lists those that do.
    """
    sim = env.sim
    if selection is True:
        return [*sim.articulations, *sim.rigid_objects, *sim.robots]
    if selection is False:
        return []
    if selection == "all_objects":
        return [*sim.rigid_objects, *sim.articulations]
    if selection == "all_robots":
        return [*sim.robots]
    names = [selection] if isinstance(selection, str) else selection
    for name in names:
        asset_of(env, name, path)
    return names


@register_term("event", name="prepare_extra_attr")
class PrepareExtraAttr(Term):
    """Attaches attributes to entities, as ``env.extra_attrs[uid][name]``.

    Args:
        attrs: Each a map with `name`; `entity_uids` (names, `all_objects` or `all_robots`) or
            `entity_cfg`; and `value`, or `mode: callable` with `func_name` (a method of the
            entity's handle, or ``package.module:function`` that gets env, env_ids and the handle)
            and `func_kwargs`. Callables are called whenever the event is.

    Example:
        ``{func: prepare_extra_attr, mode: startup, params: {attrs: [{name: grasp_width, entity_uids: [cube], value: 0.04}, {name: size, mode: callable, entity_uids: all_objects, func_name: get_body_scale}]}}``
    """  # noqa: E501

    def __init__(self, env: TermContext, attrs: list[ExtraAttr]) -> None:
        self._values: list[tuple[str, str, Callable[[EnvIndex | None], Any]]] = []
        for number, attr in enumerate(attrs):
            path = f"attrs.{number}"
            for uid in _uids_with(env, attr, path):
                self._values.append((uid, attr.name, _value_of(env, attr, uid, path)))
        get_or_create(env, EXTRA_ATTRS, dict, "attrs")

    @classmethod
    def check_task(cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool) -> Any:
        """Return a mistake for each function that would be imported, where that is not allowed."""
        if allow_import:
            return []
        problems: list[Problem] = []
        for number, attr in enumerate(params["attrs"]):
            name = attr.func_name or ""
            if ":" in name:
                message = f"{name!r} {_NOT_IMPORTED}"
                problems.append(Problem(f"attrs.{number}.func_name", message))
        return problems

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Set the attributes."""
        table: dict[str, dict[str, Any]] = getattr(env, EXTRA_ATTRS)
        for uid, name, value in self._values:
            table.setdefault(uid, {})[name] = value(env_ids)


def _uids_with(env: TermContext, attr: ExtraAttr, path: str) -> list[str]:
    """The entities that an attribute belongs to."""
    if (attr.entity_cfg is None) == (attr.entity_uids is None):
        raise ConfigError([Problem(path, "give either entity_uids or entity_cfg")])
    if attr.entity_cfg is not None:
        return _uids_of(env, attr.entity_cfg.uid, f"{path}.entity_cfg.uid")
    return _uids_of(env, attr.entity_uids or [], f"{path}.entity_uids")


def _value_of(
    env: TermContext, attr: ExtraAttr, uid: str, path: str
) -> Callable[[EnvIndex | None], Any]:
    """Return a function that returns the value of an entity's attribute."""
    name = attr.func_name
    handle = env.sim.get_asset(uid)
    if attr.mode == "static":
        if attr.value is None or name is not None:
            raise ConfigError([Problem(f"{path}.value", "a static attribute needs a value")])
        return lambda env_ids: attr.value
    if name is None:
        raise ConfigError([Problem(f"{path}.func_name", "a callable attribute needs a function")])
    if ":" in name:
        function = import_object(name)
        return lambda env_ids: function(env, env_ids, handle, **attr.func_kwargs)
    if name.startswith("_") or not callable(getattr(handle, name, None)):
        methods = [n for n in dir(handle) if not n.startswith("_")]
        message = f"{type(handle).__name__} {uid!r} has no method {name!r}"
        raise ConfigError(
            [Problem(f"{path}.func_name", message, did_you_mean(name, methods).strip())]
        )
    return lambda env_ids: getattr(handle, name)(**attr.func_kwargs)


@register_term("event", name="register_info_to_env")
class RegisterInfoToEnv(Term):
    """Copies attributes and poses of entities into ``env.<registration>``.

    An attribute is called ``{uid}_{attribute}``. ``{uid}_pose`` is the entity's pose in the
    environment's frame (``{uid}_{link}_pose`` of a picked link), ``{other}_pose_{uid}`` the pose of
    another entity in the entity's frame. A partial reset writes only the rows of its environments.

    Args:
        registry: Each a map with `entity_cfg`, `attrs` and `prefix` as of `register_entity_attrs`,
            and `pose_register_params` as of `register_entity_pose` (absent: no poses).
        registration: Attribute of the environment, a dictionary; made if there is none.
        sim_update: Whether these environments take 100 physics steps before, so that objects have
            settled.

    Example:
        ``{func: register_info_to_env, mode: reset, params: {sim_update: false, registry: [{entity_cfg: {uid: cube}, attrs: [get_body_scale], pose_register_params: {to_matrix: false}}]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        registry: list[Registry],
        registration: str = "affordance_datas",
        sim_update: bool = True,
    ) -> None:
        self._env = env
        self._table = registration
        get_or_create(env, registration, dict, "registration")
        self._keys: dict[str, None] = {}
        self._registry = [(env.scene_entity(entry.entity_cfg), entry) for entry in registry]
        self._steps = _UPDATE_STEPS if sim_update else 0
        if sim_update:
            env.arrays.require_host("physics steps of some environments", "sim_update")
        for number, entry in enumerate(registry):
            if entry.pose_register_params is not None:
                path = f"registry.{number}.pose_register_params.compute_relative"
                _uids_of(env, entry.pose_register_params.compute_relative, path)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Copy everything of these environments."""
        if self._steps:
            env.sim.engine.step(self._steps, env_ids)
        for entity, entry in self._registry:
            self._put_attrs(entity.uid, entry.attrs, entry.prefix, env_ids)
            if entry.pose_register_params is not None:
                self._put_pose(entity, entry.pose_register_params, env_ids)

    def _put(self, key: str, value: Any, env_ids: EnvIndex | None) -> None:
        """Set an entry; for a tensor (N, ...) only the rows of these environments."""
        table: dict[str, Any] = getattr(self._env, self._table)
        self._keys[key] = None
        earlier: Any = table.get(key)
        are_tensors = hasattr(value, "detach") and hasattr(earlier, "detach")
        has_rows = are_tensors and len(value) == self._env.num_envs
        if env_ids is not None and has_rows and earlier.shape == value.shape:
            arrays = self._env.arrays
            merged = arrays.of(earlier).copy()  # references to the earlier tensor keep its values
            merged[env_ids] = arrays.of(value)[env_ids]
            value = tensor_of(merged)
        table[key] = value

    def state_dict(self) -> dict[str, Any]:
        """The entries written by this term (copies)."""
        table: dict[str, Any] = getattr(self._env, self._table)
        return {key: copy.deepcopy(table[key]) for key in self._keys if key in table}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state of a `state_dict`."""
        self._keys = dict.fromkeys(state)
        getattr(self._env, self._table).update(copy.deepcopy(state))

    def _put_attrs(
        self, uid: str, attrs: list[str], prefix: bool, env_ids: EnvIndex | None
    ) -> None:
        """Copy attributes of an entity: extra ones, else those of its handle."""
        extra_attrs = getattr(self._env, EXTRA_ATTRS, {}).get(uid, {})
        handle = self._env.sim.get_asset(uid)
        for attr in attrs:
            if attr in extra_attrs:
                value = extra_attrs[attr]
            elif not attr.startswith("_") and hasattr(handle, attr):
                value = getattr(handle, attr)
                if callable(value):
                    value = value()
            else:
                message = (
                    f"{uid!r} has no attribute {attr!r}, and prepare_extra_attr made none; it made "
                    f"{', '.join(extra_attrs) or 'nothing'}"
                )
                raise ConfigError([Problem("attrs", message)])
            key = f"{uid}_{attr}" if prefix else attr
            self._put(key, value, env_ids)

    def _put_pose(
        self, entity: ResolvedEntity, params: PoseParams, env_ids: EnvIndex | None
    ) -> None:
        """Copy the pose of an entity, and others in its frame."""
        env = self._env
        uid = entity.uid
        name = uid
        if entity.frame_name is not None:
            name = f"{uid}_{entity.frame_name}"
        pos = entity.position()
        quat = entity.orientation()
        poses = {f"{name}_pose": (pos, quat)}
        inverse = quat_conjugate(quat)
        for other_uid in _uids_of(env, params.compute_relative, "compute_relative"):
            if other_uid == uid:
                continue
            other = env.scene_entity({"uid": other_uid})
            relative_pos = quat_rotate(inverse, other.position() - pos)
            relative_quat = quat_multiply(inverse, other.orientation())
            poses[f"{other_uid}_pose_{name}"] = (relative_pos, relative_quat)
        if params.compute_pose_object_to_arena:
            for attr, value in getattr(env, EXTRA_ATTRS, {}).get(uid, {}).items():
                if attr.endswith("_pose_object"):
                    part_pos, part_quat = _as_pose(env.arrays.of(value), len(pos))
                    poses[f"{uid}_{attr}"] = (part_pos, part_quat)
                    arena_pos = pos + quat_rotate(quat, part_pos)
                    arena_quat = quat_multiply(quat, part_quat)
                    poses[f"{uid}_{attr.removesuffix('_object')}"] = (arena_pos, arena_quat)
        for key, pose in poses.items():
            values = np.concatenate(pose, axis=1)
            if params.to_matrix:
                values = pose_to_matrix(values)
            self._put(key, tensor_of(values.astype(np.float32)), env_ids)


def _as_pose(array: NDArray[Any], count: int) -> tuple[Floats, Floats]:
    """(N, 3) and (N, 4) of 4x4 matrices or 7-vectors, of one or of all environments."""
    array = array.astype(np.float64)
    if array.shape[-2:] == (4, 4):
        array = matrix_to_pose(array)
    elif array.shape[-1:] != (7,):
        message = f"a ..._pose_object is 4x4 or x, y, z, qw, qx, qy, qz; got {array.shape}"
        raise ConfigError([Problem("attrs", message)])
    array = np.broadcast_to(array.reshape(-1, 7), (count, 7))
    return array[:, :3], array[:, 3:]


def _attrs(
    env: TermContext,
    entity_cfg: Whole,
    attrs: list[str] | None = None,
    prefix: bool = True,
) -> list[Registry]:
    """The registry of `register_entity_attrs`.

    Args:
        entity_cfg: The entity.
        attrs: Names: what `prepare_extra_attr` made, else attributes of the entity's handle (a
            method is called).
        prefix: Whether entries are called ``{uid}_{attribute}`` instead of ``{attribute}``.
    """
    return [Registry(entity_cfg, attrs or [], prefix)]


def _poses(
    env: TermContext,
    entity_cfg: Body,
    compute_relative: Relative = "all_robots",
    compute_pose_object_to_arena: bool = True,
    to_matrix: bool = True,
) -> list[Registry]:
    """The registry of `register_entity_pose`.

    Args:
        entity_cfg: The entity, or one link, site or geom of it.
        compute_relative: Whose poses relative to the entity's are added: `all_robots`,
            `all_objects`, a list of uids, true for all of these, or false for none.
        compute_pose_object_to_arena: Whether attributes of `prepare_extra_attr` that are called
            ``..._pose_object`` (poses in the object's frame, 4x4 or x, y, z, qw, qx, qy, qz) are
            added as ``{uid}_..._pose_object`` and, in the environment's frame, ``{uid}_..._pose``.
        to_matrix: (N, 4, 4) matrices, else (N, 7) x, y, z, qw, qx, qy, qz; float32, metres.
    """
    _uids_of(env, compute_relative, "compute_relative")
    params = PoseParams(compute_relative, compute_pose_object_to_arena, to_matrix)
    return [Registry(entity_cfg, pose_register_params=params)]


_FOR_ONE_ENTITY: Final[Mapping[str, Any]] = {"only": ("registration",), "sim_update": False}
register_aliases(
    {
        "register_entity_attrs": alias(
            "register_info_to_env",
            registry=_attrs,
            **_FOR_ONE_ENTITY,
            example="{of: {uid: cube}, attrs: [get_body_scale]}",
        ),
        "register_entity_pose": alias(
            "register_info_to_env",
            registry=_poses,
            **_FOR_ONE_ENTITY,
            example="{of: {uid: cube}, compute_relative: all_robots}",
        ),
    },
    "event",
)
