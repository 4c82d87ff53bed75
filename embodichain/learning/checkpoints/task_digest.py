"""`TaskDigest`: model and MDP that a policy was trained in, to be compared with another task.

It is saved in checkpoints and exported policies, as plain values instead of a hash, so that a
difference has a name and two values. The values come from `physics_values` and `mdp_values`.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import mujoco

from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS
from embodichain.lab.sim.configs.references import REFERENCE_WORDS
from embodichain.learning.checkpoints.mdp_values import mdp_values
from embodichain.learning.checkpoints.physics_values import physics_values
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["ALLOW", "Change", "TaskDigest", "check_unchanged"]

ALLOW = "allow_changed=true"
"""Override of the command line that accepts a changed task."""

GAINED = "gained"
"""Part of parameters of which an old digest does not say whether its term had them."""
TOLD = ("rewards", "corruption", "curriculum", "mujoco", GAINED)
"""Parts that do not affect a policy's actions; a change only causes a warning."""

_FORMAT = 1
_RELATIVE, _ABSOLUTE = 1e-6, 1e-12
"""Tolerance for numbers: a model compiled on another machine may be rounded differently."""
_MOST_SHOWN = 12
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
_DONE = {"training": "trained", "recording": "recorded"}
_Difference = tuple[str, Any, Any]
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
        parts: ``model`` (element -> field -> value), the sections of `mdp_values`, and ``mujoco``
            (its version).
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
        model = {"model": physics_values(env.sim.engine.model), "mujoco": mujoco.__version__}
        return cls({**model, **mdp_values(env, group)})

    def to_json(self) -> str:
        """Return it as one JSON object without spaces."""
        return json.dumps({"format": _FORMAT, **self.parts}, separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str) -> TaskDigest | None:
        """Parse JSON; None if it has another version of the format.

        Raises:
            ValueError: If the text is damaged.
        """
        found = json.loads(text)
        if not isinstance(found, dict):
            raise ValueError("a digest is a JSON object")
        return cls(found) if found.pop("format", None) == _FORMAT else None

    def changes(self, now: TaskDigest) -> list[Change]:
        """Return the differences in `now`: first the model, then the MDP by section."""
        found: list[Change] = []
        for part in dict.fromkeys([*self.parts, *now.parts]):
            before, after = self.parts.get(part), now.parts.get(part)
            gained: set[str] = set()
            if part in SECTIONS:
                before, after = _in_words_of_today(before or {}), _in_words_of_today(after or {})
                before, after, gained = _without_gained(part, before, after)
            pairs = _model(before, after) if part == "model" else _section(part, before, after)
            for name, a, b in pairs:
                of = GAINED if name in gained else part
                found.append(Change(of, name, _text(a, b), _text(b, a)))
        return found


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
    changes = tuple(trained_in.changes(TaskDigest.of(env, group)))
    refused = [change for change in changes if change.refused]
    if refused and not allow:
        lines = "".join(f"\n  {line}" for line in _shown(refused))
        message = f"{name} was {_DONE[made]} in another task ({made} -> now):{lines}"
        raise ConfigError(f"{message}\n  {ALLOW} accepts this")
    for line in _shown(list(changes)):
        _log.warning("%s: changed since %s: %s", name, made, line)
    return changes


def _shown(changes: list[Change]) -> list[str]:
    lines = [str(change) for change in changes[:_MOST_SHOWN]]
    more = len(changes) - len(lines)
    return [*lines, f"... and {more} more"] if more else lines


def _model(before: Any, now: Any) -> Iterator[_Difference]:
    """Differences of two models: removed and new elements, and fields of the others."""
    for element in dict.fromkeys([*before, *now]):
        if element in before and element in now:
            for field in dict.fromkeys([*before[element], *now[element]]):
                values = before[element].get(field, 0), now[element].get(field, 0)
                yield from _walk(f"{element}: {field}", *values)
        elif element in before:
            yield element, "there", None
        else:
            yield element, None, "here"


def _section(part: str, before: Any, now: Any) -> Iterator[_Difference]:
    """Differences of two sections, named by config keys."""
    name = _NAMES.get(part, f"task.{part}.")
    if not isinstance(before or now, Mapping):
        yield from _walk(name, before, now)
        return
    a, b = before or {}, now or {}
    for key in dict.fromkeys([*a, *b]):
        yield from _walk(f"{name}{key}", a.get(key), b.get(key))


def _in_words_of_today(section: Mapping[str, Any]) -> dict[str, Any]:
    """Terms with the present names of their references; older digests have EmbodiChain's."""
    terms = {name: term for name, term in section.items() if isinstance(term, Mapping)}
    return {**section, **{name: _with_renamed_references(term) for name, term in terms.items()}}


def _with_renamed_references(term: Mapping[str, Any]) -> dict[str, Any]:
    parts = {key: term[key] for key in ("params", "takes") if isinstance(term.get(key), Mapping)}
    renamed = {
        key: {REFERENCE_WORDS.get(name, name): value for name, value in values.items()}
        for key, values in parts.items()
    }
    return {**term, **renamed}


def _without_gained(
    part: str, before: Mapping[str, Any], now: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any], set[str]]:
    """Leave out parameters at their default that a term did not have before.

    Returns:
        Two sections without ``takes``; and the names of parameters that may be such, where the
        digest is of a version that did not say which parameters there were.
    """
    left: dict[str, Any] = {}
    gained: set[str] = set()
    for name, term in now.items():
        earlier = before.get(name)
        left[name] = term
        if not (isinstance(term, Mapping) and isinstance(earlier, Mapping)):
            continue
        params, had = dict(term.get("params", {})), earlier.get("takes")
        for key, kind in term.get("takes", {}).items():
            if kind != "default" or key in (earlier.get("params", {}) if had is None else had):
                continue
            if had is None:
                gained.add(f"task.{part}.{name}.params.{key}")
            else:
                params.pop(key, None)
        left[name] = {**term, "params": params}
    return _without_takes(before), _without_takes(left), gained


def _without_takes(section: Mapping[str, Any]) -> dict[str, Any]:
    terms = {name: term for name, term in section.items() if isinstance(term, Mapping)}
    bare = {name: {k: v for k, v in term.items() if k != "takes"} for name, term in terms.items()}
    return {**section, **bare}


def _walk(name: str, before: Any, now: Any) -> Iterator[_Difference]:
    """The innermost values that differ within two values."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys([*before, *now]):
            yield from _walk(f"{name}.{key}", before.get(key), now.get(key))
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        different = [i for i, pair in enumerate(zip(before, now, strict=True)) if not _same(*pair)]
        if len(different) == 1:
            yield from _walk(f"{name}[{different[0]}]", before[different[0]], now[different[0]])
        elif different:
            yield name, before, now
    elif not _same(before, now):
        yield name, before, now


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=_RELATIVE, abs_tol=_ABSOLUTE)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_same, a, b))
    return bool(a == b) or not (a or b)  # zero, false and empty values are not written


def _text(value: Any, other: Any) -> str:
    """A value on one line; a missing value as the default implied by the other one."""
    if value is None or value == 0:
        nothing = {bool: "false", int: "0", float: "0"}
        return nothing.get(type(other), "none" if value is None else "0")
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
