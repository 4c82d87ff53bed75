"""The part of a config that has no mistakes, and the mistakes that show only when it is built.

Some mistakes show when the scene is compiled, some when a term is built, some at its first value,
and each of these ends the building. So that one report has all of them, wrong parts are left out,
the others are built, and so on. Mistakes that may follow from a missing part are not reported.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, asdict, fields, is_dataclass, replace
from typing import Any

from embodichain.config.checks.embodiment_needs import follows_from_name
from embodichain.config.checks.validation import check_tree, named_maps
from embodichain.config.composition.embodiments import EMBODIMENT
from embodichain.config.keys.schema import RootCfg
from embodichain.config.resolved import Checked, Resolved, thaw
from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS
from embodichain.lab.gym.envs.managers.terms.term_errors import FAILURES
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["further_mistakes"]

_JOINTED = ("robot", "robots", "articulations")
"""Sections of entities from which actions take their joints, drives and limits."""
_NAMING = ("control_parts", "attach", "attachments", "solver_cfg")
"""Keys of a robot whose entries have names that terms use."""
_MEANING = ("func", "params", "shape")
"""Keys of a term without which it is another term."""
_TRIED_ENVS = 2


def further_mistakes(
    checked: Checked, problems: Sequence[Problem], build: Callable[[Resolved], None]
) -> list[Problem]:
    """Return the mistakes that known ones hide.

    Args:
        checked: The config; its own mistakes are among the known ones.
        problems: The known mistakes.
        build: Builds a config and evaluates each term once; raises its mistakes as `ConfigError`.

    Returns:
        Each mistake with its place, but those of which a known one could be the reason.
    """
    is_other_robot = any(problem.path == EMBODIMENT for problem in problems)
    if checked.check.types.root is None or is_other_robot:
        return []
    part = _SoundPart(checked.check.types.tree)
    further: list[Problem] = []
    reported = {problem.path for problem in problems}
    new = list(problems)
    is_first = True
    while new:
        was_removed = [part.leave_out(problem) for problem in new]
        # Of the known mistakes, the check of types may have left out the parts already.
        if part.ends or not (is_first or any(was_removed)):
            return further
        is_first = False
        mistakes = _mistakes_of(part.tree, checked, build, reported)
        new = [
            problem
            for problem in mistakes
            if problem.path not in reported
            and not follows_from_name(problem, [*problems, *further])
        ]
        further += [problem for problem in new if part.may_report(problem)]
        reported |= {problem.path for problem in new}
    return further


def _mistakes_of(
    tree: Mapping[str, Any],
    checked: Checked,
    build: Callable[[Resolved], None],
    reported: set[str],
) -> list[Problem]:
    """The mistakes of a part: those of reading it or, without any, of building it."""
    check = check_tree(tree, checked.source, checked.verb)
    problems = [p for p in check.problems if p.path not in reported]
    if problems or check.types.root is None:
        return problems
    sound = replace(checked, verb="run", check=replace(check, problems=[]), ships=False).resolved()
    # A trial needs nothing that only the job needs, such as a device or a viewer.
    trial = sound.changed(
        num_envs=min(_TRIED_ENVS, sound.root.num_envs or 1),
        device="cpu",
        sim={**sound.tree["sim"], "engine": "mujoco", "backend": "local"},
        viewer={**sound.tree["viewer"], "name": "none"},
    )
    try:
        with _quiet():
            build(trial)
    except ConfigError as error:
        return list(error.problems)
    except FAILURES:
        return []  # perhaps a part that was left out is missing; if not, the build raises it again
    return []


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress warnings: the whole config, once right, gives them again."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)


class _SoundPart:
    """A config from which parts are left out.

    Args:
        tree: The config, not changed.

    Attributes:
        tree: The remaining config.
        ends: Whether too little remains to be built.
    """

    def __init__(self, tree: Mapping[str, Any]) -> None:
        self.tree: dict[str, Any] = thaw(tree)
        for key in fields(RootCfg):  # a group whose option is wrong is missing
            if key.name != "task":
                self.tree.setdefault(key.name, _plain_default(key))
        self.ends = False
        # Names of entities, terms and parts that may be missing now.
        self._lost_names: set[str] = set()
        self._are_joints_known = True
        # Key paths of maps that lack a key now, which they may need.
        self._incomplete: set[str] = set()

    def leave_out(self, problem: Problem) -> bool:
        """Remove the part with a mistake; return whether there was something to remove."""
        keys = problem.path.split(".")
        if keys[0] != "task":
            return False
        section = keys[1] if len(keys) > 1 else ""
        if section in SECTIONS and len(keys) > 2:
            return self._leave_term(section, keys[2], keys[3:], problem)
        has_joints = section in _JOINTED
        is_whole_entity = len(keys) <= (2 if section == "robot" else 3)
        sets_names = keys[-1] in ("fpath", "uid", *_NAMING)
        if not section or (has_joints and (is_whole_entity or sets_names)):
            self.ends = True  # names that terms use are unknown
            return False
        removed = _remove(self.tree, keys)
        self._incomplete.add(re.sub(r"\.[^.]+(\.\d+)*$", "", problem.path))
        if has_joints:
            self._are_joints_known = False
            for name in (*_NAMING, "names"):
                if name in keys:
                    self._lost_names.update(keys[keys.index(name) + 1 :])
        elif section in named_maps() and len(keys) > 2:
            entries = self.tree["task"].get(section) or {}
            is_key_of_object = section == "objects" and len(keys) == 4  # it may be another shape
            if section == "sensors" or is_key_of_object or keys[2] not in entries:
                self._lost_names.add(keys[2])
        return removed

    def may_report(self, problem: Problem) -> bool:
        """Whether a mistake certainly does not follow from parts that were left out."""
        if problem.path in self._incomplete:
            return False
        keys = problem.path.split(".")
        if keys[0] != "task" or len(keys) < 3 or keys[1] not in {*named_maps(), *_JOINTED}:
            return False
        if keys[1] == "objects" and keys[2] in self._lost_names:
            return False
        if keys[1] in ("actions", "curriculum") and not self._are_joints_known:
            return False
        if keys[1] in SECTIONS:
            terms = self.tree["task"].get(keys[1]) or {}
            term = {keys[2]: terms.get(keys[2])}
            if self._lost_names & set(_words(term)):
                return False
        # A control part gives a tool point its name, and an attached file its links.
        return not any(
            f"'{name}{end}" in problem.message
            for name in self._lost_names
            for end in ("'", "_tcp'", "/")
        )

    def _leave_term(self, section: str, name: str, below: list[str], problem: Problem) -> bool:
        """Remove a term with a mistake at or below it; return whether it was removed."""
        terms = self.tree["task"].get(section) or {}
        term = terms.get(name)
        if term is None:
            self._lost_names.add(name)
            return False
        if below and below[0] not in _MEANING and below[0] not in term:
            is_misspelt = any(f"'{key}'" in problem.hint for key in _MEANING)
            if not is_misspelt:  # the check of types has left out a key that a term need not have
                return False
        self._lost_names.add(name)
        self._lost_names |= set(_names_set_by(term))
        del terms[name]
        return True


def _plain_default(field: Field[Any]) -> Any:
    """The default of a key of the root, as plain values."""
    default = field.default if field.default_factory is MISSING else field.default_factory()
    if is_dataclass(default) and not isinstance(default, type):
        return asdict(default)
    return default


def _names_set_by(term: Mapping[str, Any]) -> Iterator[str]:
    """The names under which a term stores something for others."""
    for key, value in {**term, **(term.get("params") or {})}.items():
        if isinstance(value, str) and (key == "name" or str(key).endswith("_key")):
            yield value


def _words(value: Any) -> Iterator[str]:
    """All keys and texts within a value, whole and by their parts."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _words(str(key))
            yield from _words(item)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _words(item)
    elif isinstance(value, str):
        yield from (value, *re.split(r"[/.]", value))


def _remove(tree: dict[str, Any], keys: Sequence[str]) -> bool:
    """Remove a key, or the list that contains it; return whether it was there."""
    node: Any = tree
    for key in keys[:-1]:
        inner = node.get(key)
        if not isinstance(inner, dict):
            return node.pop(key, None) is not None
        node = inner
    return node.pop(keys[-1], None) is not None
