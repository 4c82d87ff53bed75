"""Events that copy attributes and poses of entities into a dictionary on the environment."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.cfg import SceneEntityCfg
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp import _rows
from embodichain.lab.gym.envs.mdp._kinematics import apply, matmul
from embodichain.lab.gym.envs.mdp._stored import stored
from embodichain.lab.gym.envs.mdp.events.extra_attributes import EXTRA_ATTRS, uids_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import matrix_to_pose, pose_to_matrix

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = ["RegisterEntityAttrs", "RegisterEntityPose", "RegisterInfoToEnv"]

Relative = bool | str | list[str]
_UPDATE_STEPS = 100
"""Physics steps of `sim_update`, as in EmbodiChain."""


@dataclass
class PoseParams:
    """How `register_entity_pose` registers; see there."""

    __pydantic_config__ = {"extra": "forbid"}

    compute_relative: Relative = "all_robots"
    compute_pose_object_to_arena: bool = True
    to_matrix: bool = True


@dataclass
class Registry:
    """What `register_info_to_env` registers of one entity."""

    __pydantic_config__ = {"extra": "forbid"}

    entity_cfg: SceneEntityCfg
    attrs: list[str] = field(default_factory=list)
    prefix: bool = True
    pose_register_params: PoseParams | None = None


class _Register(Term):
    """Writes into ``env.<registration>`` and remembers under which keys."""

    def __init__(self, env: TermContext, registration: str) -> None:
        stored(env, registration, dict, "registration")
        self._env, self._name = env, registration
        self._keys: dict[str, None] = {}

    def _put(self, key: str, value: Any, env_ids: EnvIndex | None) -> None:
        """Set an entry; of a tensor (N, ...) only the rows of these environments."""
        table: dict[str, Any] = getattr(self._env, self._name)
        self._keys[key] = None
        old = table.get(key)
        if (
            env_ids is not None
            and isinstance(value, torch.Tensor)
            and isinstance(old, torch.Tensor)
            and old.shape == value.shape
            and len(value) == self._env.num_envs
        ):
            rows = torch.from_numpy(env_ids)
            merged = old.clone()
            merged[rows] = value[rows]
            value = merged
        table[key] = value

    def state_dict(self) -> dict[str, Any]:
        """The entries written by this term (copies)."""
        table: dict[str, Any] = getattr(self._env, self._name)
        return {key: copy.deepcopy(table[key]) for key in self._keys if key in table}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._keys = dict.fromkeys(state)
        getattr(self._env, self._name).update(copy.deepcopy(state))

    def _put_attrs(
        self, uid: str, attrs: list[str], prefix: bool, env_ids: EnvIndex | None
    ) -> None:
        extra = getattr(self._env, EXTRA_ATTRS, {}).get(uid, {})
        handle = self._env.sim.get_asset(uid)
        for attr in attrs:
            if attr in extra:
                value = extra[attr]
            elif not attr.startswith("_") and hasattr(handle, attr):
                value = getattr(handle, attr)
                value = value() if callable(value) else value
            else:
                raise ValueError(
                    f"{uid!r} has no attribute {attr!r}, and prepare_extra_attr made none; it made "
                    f"{', '.join(extra) or 'nothing'}"
                )
            self._put(f"{uid}_{attr}" if prefix else attr, value, env_ids)

    def _put_pose(self, entity: ResolvedEntity, how: PoseParams, env_ids: EnvIndex | None) -> None:
        env = self._env
        name = entity.uid if entity.link_name is None else f"{entity.uid}_{entity.link_name}"
        pose = _matrices(entity)
        found = {f"{name}_pose": pose}
        for other in _others(env, how.compute_relative):
            if other != entity.uid:
                there = _matrices(env.scene_entity({"uid": other}))
                found[f"{other}_pose_{name}"] = _relative(pose, there)
        if how.compute_pose_object_to_arena:
            for attr, value in getattr(env, EXTRA_ATTRS, {}).get(entity.uid, {}).items():
                if attr.endswith("_pose_object"):
                    part = np.broadcast_to(_as_matrices(value), pose.shape)
                    found[f"{entity.uid}_{attr}"] = part
                    at = attr.removesuffix("_object")
                    found[f"{entity.uid}_{at}"] = _product(pose, part)
        for key, matrices in found.items():
            values = matrices if how.to_matrix else matrix_to_pose(matrices)
            self._put(key, _rows.tensor(values), env_ids)


@register_term("event", name="register_entity_attrs")
class RegisterEntityAttrs(_Register):
    """Copies attributes of an entity into ``env.<registration>``: EmbodiChain's event.

    Args:
        entity_cfg: The entity.
        registration: Attribute of the environment that holds the dictionary; made if there is none.
        attrs: Names: what `prepare_extra_attr` made, else attributes of the entity's handle (a
            method is called).
        prefix: Whether entries are called ``{uid}_{attribute}`` instead of ``{attribute}``.

    Example:
        ``{func: register_entity_attrs, mode: reset, params: {entity_cfg: {uid: cube}, attrs: [get_body_scale]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        registration: str = "affordance_datas",
        attrs: list[str] | None = None,
        prefix: bool = True,
    ) -> None:
        super().__init__(env, registration)
        self._args = entity_cfg.uid, attrs or [], prefix

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Copy the attributes."""
        self._put_attrs(*self._args, env_ids)


@register_term("event", name="register_entity_pose")
class RegisterEntityPose(_Register):
    """Copies poses of an entity into ``env.<registration>``: EmbodiChain's event.

    ``{uid}_pose`` is the entity's pose in the environment's frame (``{uid}_{link}_pose`` of a
    picked link); ``{other}_pose_{uid}`` another's pose in the entity's frame. All environments have
    a row; a partial reset renews only its own.

    Args:
        entity_cfg: The entity, or one link of it.
        registration: Attribute of the environment that holds the dictionary; made if there is none.
        compute_relative: Whose poses relative to the entity's are added: `all_robots`,
            `all_objects`, a list of uids, true for all of these, or false for none.
        compute_pose_object_to_arena: Whether attributes of `prepare_extra_attr` that are called
            ``..._pose_object`` (poses in the object's frame, 4x4 or x, y, z, qw, qx, qy, qz) are
            added as ``{uid}_..._pose_object`` and, in the environment's frame, ``{uid}_..._pose``.
        to_matrix: (N, 4, 4) matrices, else (N, 7) x, y, z, qw, qx, qy, qz; float32, metres.

    Example:
        ``{func: register_entity_pose, mode: reset, params: {entity_cfg: {uid: cube}, compute_relative: all_robots}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        registration: str = "affordance_datas",
        compute_relative: Relative = "all_robots",
        compute_pose_object_to_arena: bool = True,
        to_matrix: bool = True,
    ) -> None:
        super().__init__(env, registration)
        self._entity = entity_cfg
        self._how = PoseParams(compute_relative, compute_pose_object_to_arena, to_matrix)
        _others(env, compute_relative)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Copy the poses of these environments."""
        self._put_pose(self._entity, self._how, env_ids)


@register_term("event", name="register_info_to_env")
class RegisterInfoToEnv(_Register):
    """Does `register_entity_attrs` and `register_entity_pose` for several entities.

    Args:
        registry: Each a map with `entity_cfg`, `attrs` and `prefix` as of `register_entity_attrs`,
            and `pose_register_params` as of `register_entity_pose` (absent: no poses).
        registration: Attribute of the environment that holds the dictionary; made if there is none.
        sim_update: Whether these environments take 100 physics steps before, so that what was
            placed has settled.

    Example:
        ``{func: register_info_to_env, mode: reset, params: {sim_update: false, registry: [{entity_cfg: {uid: cube}, attrs: [get_body_scale], pose_register_params: {to_matrix: false}}]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        registry: list[Registry],
        registration: str = "affordance_datas",
        sim_update: bool = True,
    ) -> None:
        super().__init__(env, registration)
        self._registry = [(env.scene_entity(entry.entity_cfg), entry) for entry in registry]
        self._steps = _UPDATE_STEPS if sim_update else 0
        for number, entry in enumerate(registry):
            if entry.pose_register_params is not None:
                path = f"registry.{number}.pose_register_params.compute_relative"
                _others(env, entry.pose_register_params.compute_relative, path)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Copy everything of these environments."""
        if self._steps:
            env.sim.engine.step(self._steps, env_ids)
        for entity, entry in self._registry:
            self._put_attrs(entity.uid, entry.attrs, entry.prefix, env_ids)
            if entry.pose_register_params is not None:
                self._put_pose(entity, entry.pose_register_params, env_ids)


def _others(env: TermContext, which: Relative, path: str = "compute_relative") -> list[str]:
    if isinstance(which, bool):
        sim = env.sim
        return [*sim.articulations, *sim.rigid_objects, *sim.robots] if which else []
    return uids_of(env, which, path)


def _matrices(entity: ResolvedEntity) -> F64:
    """(N, 4, 4) float64 poses of the picked link, else of the root."""
    asset, body = entity.asset, entity.link_body
    if body is None:
        pos, quat = asset.read_pose()
    else:
        engine = asset.engine
        pos, quat = engine.derived("xpos")[:, body], engine.derived("xquat")[:, body]
    return pose_to_matrix(np.concatenate([pos, quat], axis=1))


def _as_matrices(value: Any) -> F64:
    """(1 or N, 4, 4) of 4x4 matrices or 7-vectors."""
    array = np.asarray(value, np.float64)
    if array.shape[-2:] != (4, 4):
        if array.shape[-1:] != (7,):
            message = f"a ..._pose_object is 4x4 or x, y, z, qw, qx, qy, qz; got {array.shape}"
            raise ConfigError([Problem("attrs", message)])
        array = pose_to_matrix(array)
    return array.reshape(-1, 4, 4)


def _product(a: F64, b: F64) -> F64:
    """Pose b, given in the frame of pose a."""
    out = a.copy()
    out[:, :3, :3] = matmul(a[:, :3, :3], b[:, :3, :3])
    out[:, :3, 3] = a[:, :3, 3] + apply(a[:, :3, :3], b[:, :3, 3])
    return out


def _relative(a: F64, b: F64) -> F64:
    """Pose b in the frame of pose a."""
    back = a.copy()
    turned = np.swapaxes(a[:, :3, :3], 1, 2)
    back[:, :3, :3] = turned
    back[:, :3, 3] = -apply(turned, a[:, :3, 3])
    return _product(back, b)
