"""`ResolvedEntity`: what a `SceneEntityCfg` means in a scene, with joints and links as indices.

A scene check before anything is built lives in `embodichain.lab.sim.compiler.describe`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pydantic import GetCoreSchemaHandler, TypeAdapter, ValidationError

from embodichain.lab.gym.envs.cfg import Names, SceneEntityCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = ["ResolvedEntity", "resolve_entity"]


@dataclass(frozen=True, eq=False)
class ResolvedEntity:
    """An entity of the scene and the joints and links that were picked.

    A term's parameter annotated with this class, or with `SceneEntityCfg`, receives one.

    Attributes:
        uid: The entity.
        asset: Its handle: a `Robot`, `Articulation` or `RigidObject`.
        joint_ids: Picked joints; without a choice all active ones (no mimic joints). Empty for
            rigid objects.
        joint_names: Their names.
        link_ids: Picked links; without a choice none, which means the root.
        link_names: Their names.
        control_parts: Picked control parts.
        all_joints: Whether `joint_ids` is every joint in the entity's order, so that no indexing
            is needed.
    """

    uid: str
    asset: Any
    joint_ids: tuple[int, ...] = ()
    joint_names: tuple[str, ...] = ()
    link_ids: tuple[int, ...] = ()
    link_names: tuple[str, ...] = ()
    all_joints: bool = False
    control_parts: tuple[str, ...] = ()

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """In a config it is written as a `SceneEntityCfg`."""
        return handler.generate_schema(SceneEntityCfg)

    @property
    def joints(self) -> list[int] | None:
        """`joint_ids` as handles take them: None is all."""
        return None if self.all_joints else list(self.joint_ids)

    @property
    def body_ids(self) -> tuple[int, ...]:
        """EmbodiChain's name of `link_ids`."""
        return self.link_ids

    @property
    def body_names(self) -> tuple[str, ...]:
        """EmbodiChain's name of `link_names`."""
        return self.link_names

    @property
    def link_name(self) -> str | None:
        """The one picked link, or None for the root.

        Raises:
            ConfigError: If several were picked.
        """
        if len(self.link_names) > 1:
            raise ConfigError(f"one link of {self.uid!r} is wanted, got {list(self.link_names)}")
        return self.link_names[0] if self.link_names else None

    @cached_property
    def link_body(self) -> int | None:
        """MuJoCo body id of the one picked link, or None for the root."""
        name = self.link_name
        return None if name is None else int(self.asset.body_of(name))


def resolve_entity(
    sim: SimulationManager, cfg: SceneEntityCfg | Mapping[str, Any] | ResolvedEntity
) -> ResolvedEntity:
    """Look an entity up in the scene.

    Args:
        sim: The scene.
        cfg: What to look up; a mapping is read as a `SceneEntityCfg`.

    Raises:
        ConfigError: If the entity, a joint or a link does not exist; lists what does.
    """
    if isinstance(cfg, ResolvedEntity):
        return cfg
    if not isinstance(cfg, SceneEntityCfg):
        cfg = _from_mapping(cfg)
    assets: dict[str, Any] = {**sim.robots, **sim.articulations, **sim.rigid_objects}
    if cfg.uid not in assets:
        known = ", ".join(assets) or "none"
        hint = did_you_mean(cfg.uid, assets).strip()
        message = f"no entity is called {cfg.uid!r}; there are: {known}"
        raise ConfigError([Problem("uid", message, hint)])
    asset = assets[cfg.uid]
    parsed = getattr(asset, "parsed", None)
    if parsed is None:
        return _object(cfg, asset)
    joints, parts = _joints(cfg, parsed), _parts(cfg, parsed)
    links = _links(cfg, parsed)
    return ResolvedEntity(
        uid=cfg.uid,
        asset=asset,
        joint_ids=tuple(joints),
        joint_names=tuple(parsed.joint_names[i] for i in joints),
        link_ids=tuple(links),
        link_names=tuple(parsed.link_names[i] for i in links),
        all_joints=joints == list(range(len(parsed.joint_names))),
        control_parts=parts,
    )


def _from_mapping(cfg: Mapping[str, Any]) -> SceneEntityCfg:
    try:
        return TypeAdapter(SceneEntityCfg).validate_python(dict(cfg))
    except ValidationError as error:
        raise ConfigError(
            [Problem(".".join(map(str, e["loc"])), e["msg"]) for e in error.errors()]
        ) from error


def _object(cfg: SceneEntityCfg, asset: Any) -> ResolvedEntity:
    """A rigid object is one body: it has no joints, and its only link is itself."""
    for name in ("joint_names", "control_parts", "joint_ids"):
        if getattr(cfg, name):
            raise ConfigError([Problem(name, f"{cfg.uid!r} is a rigid object without joints")])
    for name in ("link_names", "body_names"):
        if getattr(cfg, name) is not None:
            _pick(getattr(cfg, name), [cfg.uid], "link", cfg.uid, name)
    return ResolvedEntity(cfg.uid, asset)


def _joints(cfg: SceneEntityCfg, parsed: Any) -> list[int]:
    names = list(parsed.joint_names)
    if cfg.joint_ids is not None:
        return _ids(cfg.joint_ids, names, "joint", cfg.uid, "joint_ids")
    picked: list[int] = []
    mimic = {int(i) for i in parsed.mimic_ids}
    for part in _parts(cfg, parsed):
        picked += [i for i in parsed.control_parts[part] if i not in mimic]
    if cfg.joint_names is not None:
        picked += _pick(cfg.joint_names, names, "joint", cfg.uid, "joint_names")
    if cfg.joint_names is None and cfg.control_parts is None:
        return [i for i in range(len(names)) if i not in mimic]
    return _ordered(picked, cfg)


def _parts(cfg: SceneEntityCfg, parsed: Any) -> tuple[str, ...]:
    if cfg.control_parts is None:
        return ()
    parts = list(parsed.control_parts)
    picked = _pick(cfg.control_parts, parts, "control part", cfg.uid, "control_parts")
    return tuple(parts[i] for i in picked)


def _links(cfg: SceneEntityCfg, parsed: Any) -> list[int]:
    names = list(parsed.link_names)
    if cfg.body_ids is not None:
        return _ids(cfg.body_ids, names, "link", cfg.uid, "body_ids")
    picked: list[int] = []
    for key in ("link_names", "body_names"):
        wanted = getattr(cfg, key)
        if wanted is not None:
            picked += _pick(wanted, names, "link", cfg.uid, key)
    return _ordered(picked, cfg)


def _ordered(picked: list[int], cfg: SceneEntityCfg) -> list[int]:
    unique = list(dict.fromkeys(picked))
    return unique if cfg.preserve_order else sorted(unique)


def _pick(wanted: Names, names: Sequence[str], what: str, uid: str, key: str) -> list[int]:
    """Indices of the names that each pattern matches in full, in the order of the patterns."""
    picked: list[int] = []
    for pattern in [wanted] if isinstance(wanted, str) else wanted or []:
        try:
            found = [i for i, name in enumerate(names) if re.fullmatch(pattern, name)]
        except re.error as error:
            raise ConfigError([Problem(key, f"malformed regex {pattern!r}: {error}")]) from error
        if not found:
            message = f"no {what} of {uid!r} matches {pattern!r}; there are: {', '.join(names)}"
            raise ConfigError([Problem(key, message, did_you_mean(pattern, names).strip())])
        picked += found
    return picked


def _ids(ids: Sequence[int], names: Sequence[str], what: str, uid: str, key: str) -> list[int]:
    wrong = [i for i in ids if not 0 <= i < len(names)]
    if wrong:
        message = f"{uid!r} has {len(names)} {what}s, numbered from 0; got {wrong}"
        raise ConfigError([Problem(key, message)])
    return list(ids)
