"""`ResolvedEntity`: what a `SceneEntityCfg` means in a scene, with joints and links as indices.

What a reference picks is `compiler.entity_names.pick`, which checks a config too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pydantic import GetCoreSchemaHandler, TypeAdapter, ValidationError

from embodichain.lab.gym.envs.cfg import SceneEntityCfg
from embodichain.utils.errors import ConfigError, Problem

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
        path: Its key path, for messages; empty if Python code made it.
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
    path: str = ""

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
            message = f"one link of {self.uid!r} is wanted, got {', '.join(self.link_names)}"
            raise ConfigError([Problem(f"{self.path}.link_names".lstrip("."), message)])
        return self.link_names[0] if self.link_names else None

    @cached_property
    def link_body(self) -> int | None:
        """MuJoCo body id of the one picked link, or None for the root."""
        name = self.link_name
        return None if name is None else int(self.asset.body_of(name))


def resolve_entity(
    sim: SimulationManager,
    cfg: SceneEntityCfg | Mapping[str, Any] | ResolvedEntity,
    path: str = "",
) -> ResolvedEntity:
    """Look an entity up in the scene.

    Args:
        sim: The scene.
        cfg: What to look up; a mapping is read as a `SceneEntityCfg`.
        path: Its key path.

    Raises:
        ConfigError: If the entity, a joint or a link does not exist; lists what does.
    """
    if isinstance(cfg, ResolvedEntity):
        return cfg
    from embodichain.lab.sim.compiler.articulation import ParsedArticulation  # imports MuJoCo
    from embodichain.lab.sim.compiler.entity_names import pick

    if not isinstance(cfg, SceneEntityCfg):
        cfg = _from_mapping(cfg)
    assets: dict[str, Any] = {**sim.robots, **sim.articulations, **sim.rigid_objects}
    known: dict[str, ParsedArticulation | str | None] = {
        **{uid: getattr(asset, "parsed", "rigid object") for uid, asset in assets.items()},
        **dict.fromkeys(sim.lights, "light"),
    }
    picked, problems = pick(path, vars(cfg), known)
    if problems:
        raise ConfigError(problems)
    asset = assets[cfg.uid]
    parsed = known[cfg.uid]
    if not isinstance(parsed, ParsedArticulation):
        return ResolvedEntity(cfg.uid, asset, path=path)
    return ResolvedEntity(
        uid=cfg.uid,
        asset=asset,
        joint_ids=picked.joints,
        joint_names=tuple(parsed.joint_names[i] for i in picked.joints),
        link_ids=picked.links,
        link_names=tuple(parsed.link_names[i] for i in picked.links),
        control_parts=picked.parts,
        path=path,
        all_joints=picked.joints == tuple(range(len(parsed.joint_names))),
    )


def _from_mapping(cfg: Mapping[str, Any]) -> SceneEntityCfg:
    try:
        return TypeAdapter(SceneEntityCfg).validate_python(dict(cfg))
    except ValidationError as error:
        raise ConfigError(
            [Problem(".".join(map(str, e["loc"])), e["msg"]) for e in error.errors()]
        ) from error
