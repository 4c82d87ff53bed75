"""Values that follow from others: suggested ones, defaults of null keys, the environment's config.

Works on trees that were composed; that they are right is checked before and after. What follows
from a task's own values (`decimation`, `episode_length_s`, `physics`) is `BaseEnv`'s to fill in.
"""

from __future__ import annotations

import copy
import secrets
from collections.abc import Callable, Mapping
from typing import Any, Literal

from embodichain.config.locate import LocatedProblem
from embodichain.config.schema import SUGGESTED_KEYS, RootCfg
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.lab.sim.compiler.names import exact_pattern
from embodichain.lab.sim.prepared_scene import PreparedScene

__all__ = ["Chosen", "Verb", "env_cfg", "fill", "settle", "with_armature"]

Verb = Literal["run", "train"]
Chosen = Callable[[str, str], bool]
"""``chosen(path, package)``: whether a key was set by someone besides the option at `package`."""

_DEFAULTS: dict[Verb, dict[str, Any]] = {
    "run": {"num_envs": 1, "device": "cpu", "episodes": 1, "policy": "random"},
    "train": {"num_envs": 1, "device": "cpu"},
}
_SEED_BITS = 31


def fill(tree: Mapping[str, Any], verb: Verb, chosen: Chosen | None = None) -> dict[str, Any]:
    """Return a copy in which the task's suggestions stand where the user left null.

    Args:
        tree: A composed config.
        verb: Whose suggestions count.
        chosen: Tells which keys of `algo` the user set: these win over the suggestions. None takes
            them all for the user's.
    """
    filled = copy.deepcopy(dict(tree))
    suggested = _suggested(filled, verb)
    for key in SUGGESTED_KEYS:
        if filled.get(key) is None and suggested.get(key) is not None:
            filled[key] = suggested[key]
    algo, mine = filled.get("algo"), suggested.get("algo")
    if chosen is None or not (isinstance(algo, dict) and isinstance(mine, dict)):
        return filled
    if mine.get("name", algo.get("name")) == algo.get("name"):
        filled["algo"] = _merged(algo, mine, "algo", chosen)
    return filled


def settle(tree: Mapping[str, Any], verb: Verb) -> dict[str, Any]:
    """Return a copy of a filled tree in which what is still null has its default.

    A seed is drawn, so that the run can be done again with it.
    """
    settled = copy.deepcopy(dict(tree))
    for key, default in _DEFAULTS[verb].items():
        if settled.get(key) is None:
            settled[key] = default
    if settled.get("seed") is None:
        settled["seed"] = secrets.randbits(_SEED_BITS)
    return settled


def env_cfg(root: RootCfg) -> EnvCfg:
    """Return the config of the environment: the task, and what of the root concerns it.

    Args:
        root: A settled config.
    """
    cfg = copy.deepcopy(root.task)
    cfg.num_envs = root.num_envs or 1
    cfg.seed = root.seed
    cfg.sim_cfg = SimulationManagerCfg(
        headless=root.viewer.name != "native",
        window_env=root.viewer.env,
        num_envs=cfg.num_envs,
        sim_device=root.device or "cpu",
        num_threads=root.sim.num_threads,
        persistent=root.sim.persistent,
    )
    return cfg


def _suggested(tree: Mapping[str, Any], verb: Verb) -> dict[str, Any]:
    node: Any = tree
    for key in ("task", "suggested", verb):
        node = node.get(key) if isinstance(node, Mapping) else None
    return dict(node) if isinstance(node, Mapping) else {}


def _merged(algo: dict[str, Any], suggested: dict[str, Any], path: str, chosen: Chosen) -> Any:
    """Suggestions over the group option's values, but under what the user set."""
    merged = dict(algo)
    for key, value in suggested.items():
        where, mine = f"{path}.{key}", merged.get(key)
        if isinstance(mine, dict) and isinstance(value, dict):
            merged[key] = _merged(mine, value, where, chosen)
        elif not chosen(where, "algo"):
            merged[key] = value
    return merged


def with_armature(
    tree: Mapping[str, Any], prepared: PreparedScene
) -> tuple[dict[str, Any], tuple[LocatedProblem, ...]]:
    """Return a copy of a checked, settled tree with the armature that its joints lack.

    Only joints whose armature the task does not give are changed.

    Args:
        tree: A settled tree without mistakes.
        prepared: Its scene, as checked; its articulations' configs are changed likewise.

    Returns:
        The tree, and a note for every articulation that was changed.
    """
    changed, notes = copy.deepcopy(dict(tree)), []
    for path, raised in prepared.settle_armature().items():
        entity = changed["task"]
        for key in path.split("."):
            entity = entity[key]
        drives = entity["drive_pros"] = dict(entity.get("drive_pros") or {})
        names = {exact_pattern(name): value for name, value in raised.items()}
        drives["armature"] = {**(drives.get("armature") or {}), **names}
        listed = ", ".join(f"{name}: {value:.4g}" for name, value in raised.items())
        message = f"raised to {{{listed}}}, because limited drives would chatter at the time step"
        notes.append(LocatedProblem(f"task.{path}.drive_pros.armature", message))
    return changed, tuple(notes)
