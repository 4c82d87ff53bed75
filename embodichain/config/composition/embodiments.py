"""`list_embodiments`: the options of the group `embodiment`, and what each says of its robots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.types import RunMode
from omegaconf import OmegaConf

from embodichain.config.composition.hydra_loader import (
    COMPOSING,
    config_loader,
    explain,
    origin_of,
)

__all__ = ["EMBODIMENT", "Embodiment", "list_embodiments"]

EMBODIMENT = "embodiment"
"""The group."""


@dataclass(frozen=True)
class Embodiment:
    """An option of the group.

    Attributes:
        name: The option.
        robots: The uids of its robots.
        files: The files of its robots.
        names: The names of links that every robot of it has.
        parts: The control parts that every robot of it has.
        source: Where its file is from: ``embodichain``, ``--config-dir``...
        fault: Why it cannot be composed; empty if it can.
    """

    name: str
    robots: tuple[str, ...]
    files: tuple[str, ...]
    names: tuple[str, ...]
    parts: tuple[str, ...]
    source: str
    fault: str = ""


def list_embodiments(config_dir: str | Path | None = None) -> list[Embodiment]:
    """Return every option of the group, sorted by name; one with a mistake is returned too.

    Args:
        config_dir: A folder with the user's groups.
    """
    embodiments: list[Embodiment] = []
    with config_loader(config_dir) as loader:
        for name in loader.get_group_options(EMBODIMENT):
            path = f"{EMBODIMENT}/{name}"
            place = next(s for s in loader.get_sources() if s.is_config(path))
            source = origin_of(place)
            fault = ""
            tree: Any = {}
            try:
                config = loader.load_configuration(path, [], RunMode.RUN)
                tree = OmegaConf.to_container(config.get(EMBODIMENT, {}), resolve=False)
            except COMPOSING as error:
                fault = "; ".join(map(str, explain(error, loader)))
            robots = _robots_of(tree)
            embodiments.append(
                Embodiment(
                    name=name,
                    robots=tuple(robots),
                    files=tuple(str(r["fpath"]) for r in robots.values() if r.get("fpath")),
                    names=_common("names", robots),
                    parts=_common("control_parts", robots),
                    source=source,
                    fault=fault,
                )
            )
    return embodiments


def _robots_of(tree: Any) -> dict[str, Mapping[str, Any]]:
    """Return uid -> robot of an embodiment's file."""
    if not isinstance(tree, Mapping):
        return {}
    robots: dict[str, Mapping[str, Any]] = {}
    robot = tree.get("robot")
    if isinstance(robot, Mapping):
        robots[str(robot.get("uid", "robot"))] = robot
    several = tree.get("robots")
    if isinstance(several, Mapping):
        for uid, cfg in several.items():
            if isinstance(cfg, Mapping):
                robots[str(uid)] = cfg
    return robots


def _common(key: str, robots: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """Return the keys of a map that all robots have, in the order of the first."""
    maps = [robot.get(key) or {} for robot in robots.values()]
    if not maps:
        return ()
    return tuple(str(name) for name in maps[0] if all(name in other for other in maps[1:]))
