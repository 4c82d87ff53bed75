"""What is left of a config without its mistakes, and the mistakes that show only there.

Some mistakes show when the scene is compiled, some when a term is built, some at its first value,
and each of these ends the building. So that one report has all of them, what is wrong is left out,
the rest is built, and so on. What may follow from a part that is missing is not reported.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, asdict, fields, is_dataclass, replace
from typing import Any

from embodichain.config.checks.validation import check_tree, named_maps
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
        Each mistake with its place; none that a known one could be the reason of.
    """
    if checked.check.types.root is None:
        return []
    part = _SoundPart(checked.check.types.tree)
    found: list[Problem] = []
    known = {problem.path for problem in problems}
    new, pruned = list(problems), True
    while new:
        left_out = [part.leave_out(problem) for problem in new]
        if part.ends or not (pruned or any(left_out)):
            return found
        pruned = False  # the check of types has left out some of the first ones
        new = [p for p in _mistakes_of(part.tree, checked, build, known) if p.path not in known]
        found += [problem for problem in new if part.may_say(problem)]
        known |= {problem.path for problem in new}
    return found


def _mistakes_of(
    tree: Mapping[str, Any],
    checked: Checked,
    build: Callable[[Resolved], None],
    known: set[str],
) -> list[Problem]:
    """The mistakes of a part: those of reading it or, without any, of building it."""
    check = check_tree(tree, checked.source, checked.verb)
    problems = [p for p in check.problems if p.path not in known]
    if problems or check.types.root is None:
        return problems
    # What the job itself needs, such as a device, is no part of it.
    whole = replace(checked, verb="run", check=replace(check, problems=[]), ships=False).resolved()
    count = min(_TRIED_ENVS, whole.root.num_envs or 1)
    viewer = {**whole.tree["viewer"], "name": "none"}
    sim = {**whole.tree["sim"], "engine": "mujoco", "backend": "local"}
    tried = whole.changed(num_envs=count, device="cpu", sim=sim, viewer=viewer)
    try:
        with _quiet():
            build(tried)
    except ConfigError as error:
        return list(error.problems)
    except FAILURES:
        return []  # perhaps for want of what was left out; if not, the next round raises it
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
        tree: What is left.
        ends: Whether too little is left to be built.
    """

    def __init__(self, tree: Mapping[str, Any]) -> None:
        self.tree: dict[str, Any] = thaw(tree)
        for root in fields(RootCfg):  # a group whose option is wrong is missing
            if root.name != "task":
                self.tree.setdefault(root.name, _plain_default(root))
        self.ends = False
        self._lost: set[str] = set()
        self._joints_known = True

    def leave_out(self, problem: Problem) -> bool:
        """Remove the part with a mistake; return whether there was something to remove."""
        keys = problem.path.split(".")
        if keys[0] != "task":
            return False
        section = keys[1] if len(keys) > 1 else ""
        if section in SECTIONS and len(keys) > 2:
            return self._leave_term(section, keys[2], keys[3:], problem)
        jointed = section in _JOINTED
        deep = len(keys) > (2 if section == "robot" else 3)
        if not section or (jointed and (not deep or {"fpath", "uid", *_NAMING} & {keys[-1]})):
            self.ends = True  # its names are unknown
            return False
        removed = _remove(self.tree, keys)
        if jointed:
            self._joints_known = False
            self._lost |= {key for name in _NAMING if name in keys for key in _after(keys, name)}
        elif section in named_maps() and len(keys) > 2:
            there = self.tree["task"].get(section) or {}
            if section == "sensors" or keys[2] not in there:
                self._lost.add(keys[2])
        return removed

    def may_say(self, problem: Problem) -> bool:
        """Whether a mistake is certainly none that follows from what was left out."""
        keys = problem.path.split(".")
        if keys[0] != "task" or len(keys) < 3 or keys[1] not in {*named_maps(), *_JOINTED}:
            return False
        if keys[1] in ("actions", "curriculum") and not self._joints_known:
            return False
        section = self.tree["task"].get(keys[1]) or {}
        subject = {keys[2]: section.get(keys[2])} if keys[1] in SECTIONS else {}
        if self._lost & set(_words(subject)):
            return False
        return not any(f"'{name}'" in problem.message for name in self._lost)

    def _leave_term(self, section: str, name: str, below: list[str], problem: Problem) -> bool:
        terms = self.tree["task"].get(section) or {}
        term = terms.get(name)
        if term is None:
            self._lost.add(name)
            return False
        if below and below[0] not in _MEANING and below[0] not in term:
            meant = any(f"'{key}'" in problem.hint for key in _MEANING)
            if not meant:  # the check of types has left out a key that the term can be without
                return False
        self._lost.add(name)
        self._lost |= set(_names_given(term))
        del terms[name]
        return True


def _plain_default(field: Field[Any]) -> Any:
    """The default of a key of the root, as plain values."""
    default = field.default if field.default_factory is MISSING else field.default_factory()
    return asdict(default) if is_dataclass(default) and not isinstance(default, type) else default


def _after(keys: Sequence[str], name: str) -> list[str]:
    return list(keys[keys.index(name) + 1 :])


def _names_given(term: Mapping[str, Any]) -> Iterator[str]:
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
