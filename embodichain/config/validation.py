"""All checks of a config in one report: types, values, terms, scene; each mistake with its place.

The checks themselves live where their subjects do: types in `check_types`, terms in
`lab.gym.envs.managers`, the scene in `lab.gym.envs.scene_check`.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hydra.core.override_parser.types import OverrideType

from embodichain.config.check_types import check_types
from embodichain.config.check_values import check_root, check_suggested, check_task
from embodichain.config.composed import Composed
from embodichain.config.derive import Chosen, Verb, fill
from embodichain.config.introspect import is_named_map, type_at
from embodichain.config.problems import COMMAND_LINE, LocatedProblem
from embodichain.config.schema import LARGEST_TRAINING_SEED, RootCfg
from embodichain.lab.gym.envs.managers.check import check_terms
from embodichain.lab.sim.prepared_scene import PreparedScene
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["check_tree", "source_of", "validate"]

_SAME = {"episode_length_s": "max_episode_steps", "decimation": "sim_steps_per_control"}
"""Task keys that win over another one when given, see `EnvCfg`."""
_ENTITY = re.compile(r"task(\.(robot|(robots|objects|articulations)(\.[^.]+)?)(\.(uid|fpath))?)?")
"""Paths whose loss makes references to entities fail that are not wrong."""


def validate(
    composed: Composed, verb: Verb = "run", prepared: PreparedScene | None = None
) -> list[LocatedProblem]:
    """Return every mistake of a composed config, with those found while composing; empty is good.

    Args:
        composed: What `compose` returned.
        verb: Whose suggested values count.
        prepared: Receives the scene that was read and compiled.
    """
    problems = list(composed.problems)
    if not composed.usable:
        found = check_types({**composed.tree, "task": {}}).problems
        return problems + [LocatedProblem.of(p, source_of(p.path, composed)) for p in found]
    unknown = _unknown_entries(composed)
    lost = [p.path for p in (*problems, *unknown)]
    chosen = composed.locator.chosen
    unknown += _said_twice(composed)
    in_tree = check_tree(composed.tree, verb, chosen=chosen, lost=lost, prepared=prepared)
    found = [*unknown, *in_tree]
    return problems + [LocatedProblem.of(p, source_of(p.path, composed)) for p in found]


def source_of(path: str, composed: Composed) -> str:
    """Return where a key was set: ``FILE:LINE``, or the command line, also for a null root key."""
    if "." not in path and composed.tree.get(path) is None:
        return COMMAND_LINE
    return composed.locator.source(path)


def check_tree(
    tree: Mapping[str, Any],
    verb: Verb = "run",
    *,
    chosen: Chosen | None = None,
    lost: Sequence[str] = (),
    allow_import: bool = True,
    prepared: PreparedScene | None = None,
) -> list[Problem]:
    """Return the mistakes of a plain tree, by key path.

    Args:
        tree: A composed config, or one that was dumped.
        verb: Whose suggested values count.
        chosen: See `derive.fill`.
        lost: Paths that are known to be wrong; nothing more is said of them.
        allow_import: Whether ``package.module:function`` may be imported.
        prepared: Receives the scene that was read and compiled.
    """
    rest = copy.deepcopy(dict(tree))
    for path in lost:
        _remove(rest, path)
    problems = check_suggested(rest)
    for problem in problems:
        _remove(rest, ".".join(problem.path.split(".")[:4]))  # task.suggested.VERB.KEY
    types = check_types(fill(rest, verb, chosen))
    problems += types.problems
    missing = [*lost, *types.pruned]
    if types.root is not None:
        further = _check_meaning(types.root, verb, missing, allow_import, prepared)
        problems += [p for p in further if not _below(p.path, missing)]
    return list({p.path + p.message: p for p in problems}.values())


def _check_meaning(
    root: RootCfg,
    verb: Verb,
    missing: Sequence[str],
    allow_import: bool,
    prepared: PreparedScene | None,
) -> list[Problem]:
    """Values, terms and scene, of what has the right types."""
    problems = check_root(root, allow_import=allow_import)
    problems += check_task(root.task, allow_import=allow_import)
    if verb == "train" and root.total_timesteps is None:
        message = "missing value: set it, or task.suggested.train.total_timesteps"
        problems.append(Problem("total_timesteps", message))
    if verb == "train" and root.seed is not None and root.seed > LARGEST_TRAINING_SEED:
        message = f"training needs a seed from 0 to {LARGEST_TRAINING_SEED}, got {root.seed}"
        problems.append(Problem("seed", message))
    known = {p.path for p in problems}
    in_task = check_terms(root.task, allow_import=allow_import)
    if not any(_ENTITY.fullmatch(path) for path in missing):
        from embodichain.lab.gym.envs.scene_check import describe  # imports MuJoCo

        in_task += describe(root.task, prepared)
    found = [Problem(_in_task(p.path), p.message, p.hint) for p in in_task]
    return problems + [p for p in found if p.path not in known]


def _said_twice(composed: Composed) -> list[Problem]:
    """Two names of one thing, both set: the one that would lose is usually the one just typed."""
    task = composed.tree.get("task")
    problems = []
    for name, other in _SAME.items():
        given = isinstance(task, dict) and task.get(name) is not None
        if given and composed.locator.chosen(f"task.{other}", ""):
            back = f"task.{name}=null"
            message = f"task.{name} says it as well; set one of them ({back} takes it back)"
            problems.append(Problem(f"task.{other}", message))
    return problems


def _unknown_entries(composed: Composed) -> list[Problem]:
    """Overrides that would make a new entity or term by misspelling one; `+` says it is meant."""
    problems: dict[str, Problem] = {}
    for override in composed.locator.overrides:
        parts = override.key_or_group.split(".")
        if override.type is not OverrideType.CHANGE:
            continue
        for depth in range(1, len(parts)):
            if is_named_map(type_at(RootCfg, parts[:depth], composed.tree)):
                path = ".".join(parts[: depth + 1])
                if not composed.locator.sets(path):
                    problems[path] = _unknown_entry(path, composed)
    return list(problems.values())


def _unknown_entry(path: str, composed: Composed) -> Problem:
    section, _, name = path.rpartition(".")
    there: Any = composed.tree
    for part in section.split("."):
        there = there.get(part, {}) if isinstance(there, dict) else {}
    names = [str(key) for key in there if composed.locator.sets(f"{section}.{key}")]
    message = f"there is no {name!r} in {section}; there are: {', '.join(names) or 'none'}."
    hint = did_you_mean(name, names).strip() or f"Add one with +{path}={{...}}"
    return Problem(path, message, hint)


def _in_task(path: str) -> str:
    return f"task.{path}" if path else "task"


def _below(path: str, ancestors: Iterable[str]) -> bool:
    return any(path == a or path.startswith(f"{a}.") for a in ancestors)


def _remove(tree: dict[str, Any], path: str) -> None:
    *parents, name = path.split(".")
    node: Any = tree
    for part in parents:
        node = node.get(part) if isinstance(node, dict) else None
    if isinstance(node, dict):
        node.pop(name, None)
