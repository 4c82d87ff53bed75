"""`TaskDigest`: model and MDP that a policy was trained in, to be compared with another task.

It is saved in checkpoints and exported policies, as plain values instead of a hash, so that a
difference has a name and two values. The values come from `physics_values` and `mdp_values`.
"""

from __future__ import annotations

import json
import logging
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import mujoco

from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS
from embodichain.lab.sim.configs.references import REFERENCE_WORDS
from embodichain.learning.checkpoints.mdp_values import mdp_values
from embodichain.learning.checkpoints.physics_values import physics_values
from embodichain.learning.checkpoints.renamed_entities import with_present_names
from embodichain.utils.errors import ConfigError
from embodichain.utils.notes import warn_once

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = [
    "ALLOW",
    "Change",
    "TaskDigest",
    "check_unchanged",
    "name_other_columns",
    "without_warnings_of_changes",
]

ALLOW = "allow_changed=true"
"""Override of the command line that accepts a changed task."""

GAINED = "gained"
"""Part of parameters of which an old digest does not say whether its term had them."""
VARIED = "varied"
"""Part with the key paths that variations have set; of changes, what is at these paths."""
TOLD = ("rewards", "corruption", "curriculum", "mujoco", GAINED, VARIED)
"""Parts that do not affect a policy's actions; a change only causes a warning."""

_FORMAT = 1
# A model compiled on another machine may be rounded differently.
_RELATIVE_TOLERANCE = 1e-6
_ABSOLUTE_TOLERANCE = 1e-12
_MOST_SHOWN = 12
_ORDER = "(order)"
"""Key of a section for the order of its terms."""
_OBJECTS = "task.objects."
_NOISE = re.compile(r"task\.observations\.[^.]+\.noise(\..*)?")
_STRENGTH = "strength"
_NAMES = {
    "timing": "task.",
    "episode": "task.",
    "initial": "initial ",
    "space": "space of ",
    "corruption": "task.enable_corruption",
    "id": "task.id",
    "mujoco": "MuJoCo",
}
"""Part -> prefix of the names of its values; the default is ``task.PART.``."""
_PARTICIPLE = {"training": "trained", "recording": "recorded"}
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Change:
    """One difference from the task in training.

    Attributes:
        part: The part of the digest: ``model``, ``observations``...
        name: Its name: ``joint panda/panda_joint7: damping``, ``task.events.push.mode``.
        before: Its value in training, as text.
        now: Its value here, as text.
    """

    part: str
    name: str
    before: str
    now: str

    @property
    def refused(self) -> bool:
        """Whether the change is an error, because it affects the policy."""
        return self.part not in TOLD

    def __str__(self) -> str:
        """Return ``NAME BEFORE -> NOW``."""
        return f"{self.name} {self.before} -> {self.now}"


@dataclass(frozen=True, slots=True)
class TaskDigest:
    """Plain values of a task, by part.

    Attributes:
        parts: ``model`` (element -> field -> value), the sections of `mdp_values`, ``mujoco``
            (its version), and ``varied`` (key paths) if variations were chosen.
    """

    parts: Mapping[str, Any]

    @classmethod
    def of(cls, env: BaseEnv, group: str = "policy") -> TaskDigest:
        """Describe a built environment; independent of the number of environments and the seed.

        Args:
            env: The environment.
            group: The policy's observation group.

        Raises:
            ValueError: If no observation is in the group.
        """
        env = getattr(env, "template", env)  # of a batch in shards
        parts = {
            "model": physics_values(env.sim.engine.model),
            "mujoco": mujoco.__version__,
            **mdp_values(env, group),
        }
        sources = env.cfg.key_sources
        if sources is not None and sources.varied:
            parts[VARIED] = sorted(sources.varied)
        return cls(parts)

    def to_json(self) -> str:
        """Return it as one JSON object without spaces."""
        return json.dumps({"format": _FORMAT, **self.parts}, separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str) -> TaskDigest | None:
        """Parse JSON; None if it has another version of the format.

        Raises:
            ValueError: If the text is damaged.
        """
        parts = json.loads(text)
        if not isinstance(parts, dict):
            raise ValueError("a digest is a JSON object")
        if parts.pop("format", None) != _FORMAT:
            return None
        return cls(parts)

    def changes(self, now: TaskDigest) -> list[Change]:
        """Return the differences in `now`: first the model, then the MDP by section."""
        varied = {*self.parts.get(VARIED, ()), *now.parts.get(VARIED, ())}
        changes: list[Change] = []
        for part in dict.fromkeys([*self.parts, *now.parts]):
            if part == VARIED:  # says of the other parts where their values are from
                continue
            before = self.parts.get(part)
            after = now.parts.get(part)
            gained: set[str] = set()
            if part == "model":
                differences = _compare_models(before, after)
            elif part in SECTIONS:
                before = _without_varied_order(part, before or {}, varied)
                after = _without_varied_order(part, after or {}, varied)
                terms = _compared_terms(part, before, after)
                gained = terms.gained
                differences = _compare_sections(part, terms.before, terms.now)
            else:
                differences = _compare_sections(part, before, after)
            for difference in differences:
                kind = part
                if difference.name in gained:
                    kind = GAINED
                elif _is_varied(part, difference.name, varied):
                    kind = VARIED
                changes.append(
                    Change(
                        part=kind,
                        name=difference.name,
                        before=_text(difference.before, difference.now),
                        now=_text(difference.now, difference.before),
                    )
                )
        return changes


def _without_varied_order(
    section: str, terms: Mapping[str, Any], varied: Collection[str]
) -> Mapping[str, Any]:
    """Return terms whose order has no term that a variation has added."""
    if _ORDER not in terms:
        return terms
    order = [name for name in terms[_ORDER] if f"task.{section}.{name}" not in varied]
    others = {name: term for name, term in terms.items() if name != _ORDER}
    if len(order) > 1:
        others[_ORDER] = order
    return others


def _is_varied(part: str, name: str, varied: Iterable[str]) -> bool:
    """Whether a difference is one of a variation.

    Args:
        part: The part of the digest.
        name: The difference's name.
        varied: Key paths that variations have set.
    """
    if part in ("model", "initial"):  # what they add to the scene, and where it is at first
        uids = [path.removeprefix(_OBJECTS) for path in varied if path.startswith(_OBJECTS)]
        element = name.partition(":")[0]
        return any(re.search(rf"(?<![\w/]){re.escape(uid)}(?!\w)", element) for uid in uids)
    if part == "corruption":  # it is off where no observation has noise
        return any(_NOISE.fullmatch(path) for path in varied)
    return any(re.match(rf"{re.escape(path)}(?!\w)", name) for path in varied)


def check_unchanged(
    name: str,
    trained_in: TaskDigest | None,
    env: BaseEnv,
    group: str,
    *,
    allow: bool,
    made: Literal["training", "recording"] = "training",
) -> tuple[Change, ...]:
    """Compare the task that a policy was trained in with the one where it is to act.

    Args:
        name: The policy's name in messages.
        trained_in: The digest in the policy's file; None compares nothing.
        env: The environment that it will act in.
        group: The policy's observation group.
        allow: Whether to accept changes, with a warning.
        made: What was done in the first task, for messages: a log is compared too.

    Returns:
        The changes.

    Raises:
        ConfigError: If a change affects the policy and `allow` is not set.
    """
    if trained_in is None:
        return ()
    now = TaskDigest.of(env, group)
    scene = getattr(env, "template", env).sim  # `template` is of a batch in shards
    earlier = TaskDigest(with_present_names(trained_in.parts, now.parts, scene.known))
    changes = tuple(earlier.changes(now))
    refused = [change for change in changes if change.refused]
    if refused and not allow:
        lines = "".join(f"\n  {line}" for line in _lines(refused))
        message = f"{name} was {_PARTICIPLE[made]} in another task ({made} -> now):{lines}"
        raise ConfigError(f"{message}\n  {ALLOW} accepts this")
    varied = [change for change in changes if change.part == VARIED]
    if varied:
        names = ", ".join(_shortened([change.name for change in varied]))
        text = f"variations change what was in {made}: {names}"
        warn_once(_log, f"{name}: {text}", key=text)  # the same for each policy of a study
    for line in _lines([change for change in changes if change.part != VARIED]):
        _log.warning("%s: changed since %s: %s", name, made, line)
    return changes


def name_other_columns(trained_in: TaskDigest | None, env: BaseEnv, group: str) -> str:
    """Return which observations and actions a task has, and the one in training had not.

    Args:
        trained_in: The digest in the policy's file; None names nothing.
        env: The environment that it was to act in.
        group: The policy's observation group.

    Returns:
        ``observations only in training: to_goal (3); only here: to_cube (3)``; empty if the names
        are the same.
    """
    if trained_in is None:
        return ""
    before = trained_in.parts.get("space", {})
    now = TaskDigest.of(env, group).parts["space"]
    texts: list[str] = []
    for kind in ("observations", "actions"):
        names_before = list(before.get(kind, ()))
        names_now = list(now.get(kind, ()))
        sides = {
            "only in training": [name for name in names_before if name not in names_now],
            "only here": [name for name in names_now if name not in names_before],
        }
        parts = [
            f"{side}: {', '.join(_shortened(names))}" for side, names in sides.items() if names
        ]
        if parts:
            texts.append(f"{kind} {'; '.join(parts)}")
    return "; ".join(texts)


@contextmanager
def without_warnings_of_changes() -> Iterator[None]:
    """Let `check_unchanged` accept changes without a word, where they were said before."""
    before = _log.disabled
    _log.disabled = True
    try:
        yield
    finally:
        _log.disabled = before


def _lines(changes: list[Change]) -> list[str]:
    return _shortened([str(change) for change in changes])


def _shortened(texts: list[str]) -> list[str]:
    more = len(texts) - _MOST_SHOWN
    if more <= 0:
        return texts
    return [*texts[:_MOST_SHOWN], f"... and {more} more"]


# -- comparing ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Difference:
    """A value that differs; None where there is none.

    Attributes:
        name: Its name: ``joint panda/panda_joint7: damping``, ``task.events.push.mode``.
        before: Its value in training.
        now: Its value here.
    """

    name: str
    before: Any
    now: Any


def _compare_models(before: Any, now: Any) -> Iterator[_Difference]:
    """Compare two models: removed and new elements, and fields of the others."""
    for element in dict.fromkeys([*before, *now]):
        if element not in now:
            yield _Difference(element, "there", None)
        elif element not in before:
            yield _Difference(element, None, "here")
        else:
            for field in dict.fromkeys([*before[element], *now[element]]):
                # Fields that are zero are not written.
                value_before = before[element].get(field, 0)
                value_now = now[element].get(field, 0)
                yield from _compare_values(f"{element}: {field}", value_before, value_now)


def _compare_sections(part: str, before: Any, now: Any) -> Iterator[_Difference]:
    """Compare two sections; values are named by config keys."""
    prefix = _NAMES.get(part, f"task.{part}.")
    if not isinstance(before or now, Mapping):
        yield from _compare_values(prefix, before, now)
        return
    before = before or {}
    now = now or {}
    for key in dict.fromkeys([*before, *now]):
        yield from _compare_values(f"{prefix}{key}", before.get(key), now.get(key))


def _compare_values(name: str, before: Any, now: Any) -> Iterator[_Difference]:
    """Find the innermost values that differ within two values."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys([*before, *now]):
            yield from _compare_values(f"{name}.{key}", before.get(key), now.get(key))
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        different = [i for i in range(len(now)) if not _is_same(before[i], now[i])]
        if len(different) == 1:
            index = different[0]
            yield from _compare_values(f"{name}[{index}]", before[index], now[index])
        elif different:
            yield _Difference(name, before, now)
    elif not _is_same(before, now):
        yield _Difference(name, before, now)


def _is_same(a: Any, b: Any) -> bool:
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=_RELATIVE_TOLERANCE, abs_tol=_ABSOLUTE_TOLERANCE)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_is_same, a, b))
    return bool(a == b) or not (a or b)  # zero, false and empty values are not written


# -- terms of older digests -----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _ComparedTerms:
    """A section of terms as it was and is, without what only differs by the version.

    Attributes:
        before: The section in training, without ``takes``.
        now: The section here, likewise, and without parameters at their default that a term did
            not have in training.
        gained: Names of parameters that may be such, where the digest is of a version that did not
            say which parameters there were.
    """

    before: Mapping[str, Any]
    now: Mapping[str, Any]
    gained: set[str]


def _compared_terms(
    section: str, before: Mapping[str, Any], now: Mapping[str, Any]
) -> _ComparedTerms:
    terms_before = _rename_references(before)
    terms_now = _rename_references(now)
    gained: set[str] = set()
    for name, term in terms_now.items():
        earlier = terms_before.get(name)
        if not (isinstance(term, Mapping) and isinstance(earlier, Mapping)):
            continue
        earlier_takes: Any = earlier.get("takes")
        # A digest of an old version does not say which parameters a term had, only which were set.
        is_old = earlier_takes is None
        earlier_names = earlier.get("params", {}) if is_old else earlier_takes
        params = dict(term.get("params", {}))
        for key, kind in term.get("takes", {}).items():
            if kind != "default" or key in earlier_names:
                continue
            if is_old:
                gained.add(f"task.{section}.{name}.params.{key}")
            else:
                params.pop(key, None)
        terms_now[name] = {**term, "params": params}
        if _STRENGTH in term or _STRENGTH in earlier:  # 1 is not written
            terms_before[name] = {_STRENGTH: 1.0, **earlier}
            terms_now[name] = {_STRENGTH: 1.0, **terms_now[name]}
    return _ComparedTerms(_remove_takes(terms_before), _remove_takes(terms_now), gained)


def _rename_references(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return terms with the present names of their references; older digests have EmbodiChain's."""
    terms = dict(section)
    for name, term in section.items():
        if not isinstance(term, Mapping):
            continue
        renamed = dict(term)
        for key in ("params", "takes"):
            values = term.get(key)
            if isinstance(values, Mapping):
                renamed[key] = {REFERENCE_WORDS.get(n, n): value for n, value in values.items()}
        terms[name] = renamed
    return terms


def _remove_takes(section: Mapping[str, Any]) -> dict[str, Any]:
    terms = dict(section)
    for name, term in section.items():
        if isinstance(term, Mapping):
            terms[name] = {key: value for key, value in term.items() if key != "takes"}
    return terms


# -- words ----------------------------------------------------------------------------------------


def _text(value: Any, other: Any) -> str:
    """Return a value on one line; a missing value as the default implied by the other one."""
    if value is None or value == 0:
        if isinstance(other, bool):
            return "false"
        if value is None and not isinstance(other, (int, float)):
            return "none"
        return "0"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, list):
        return f"[{', '.join(_text(item, 0) for item in value)}]"
    if isinstance(value, Mapping) and "func" in value:
        return str(value["func"])
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{k}: {_text(v, None)}' for k, v in value.items())}}}"
    return str(value)
