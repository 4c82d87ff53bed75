"""Names in configs: regexes over names in models, uids, and references to entities."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "GROUND",
    "Jointed",
    "Known",
    "Picked",
    "check_uid",
    "exact_pattern",
    "match",
    "no_such",
    "pick",
]

GROUND = "default_plane"
"""Name of the ground plane, EmbodiChain's."""


def match(
    pattern: str, names: Sequence[str], what: str, path: str
) -> tuple[tuple[int, ...], list[Problem]]:
    """Return the indices of the names that a regex matches in full, or the problem with it.

    Args:
        pattern: The regex.
        names: The existing names.
        what: The kind of names, for messages: "joint".
        path: Key path of the pattern.
    """
    try:
        found = tuple(i for i, name in enumerate(names) if re.fullmatch(pattern, name))
    except re.error as error:
        return (), [Problem(path, f"malformed regex {pattern!r}: {error}")]
    if found:
        return found, []
    message = f"no {what} matches {pattern!r}; there are: {listing(names, pattern)}"
    return (), [Problem(path, message, _closest(pattern, names))]


def no_such(what: str, name: str, names: Sequence[str], path: str) -> Problem:
    """Return the problem that a name does not exist."""
    message = f"no {what} is called {name!r}; there are: {', '.join(names)}"
    return Problem(path, message, _closest(name, names))


def _closest(name: str, names: Sequence[str]) -> str:
    """A hint: the closest name, or that nothing is attached under the first part of the name."""
    first, slash, _ = name.partition("/")
    if slash and first.isidentifier() and not any(n.startswith(f"{first}/") for n in names):
        there = dict.fromkeys(n.partition("/")[0] for n in names if "/" in n)
        return f"Nothing is attached as {first!r}.{did_you_mean(first, list(there))}"
    return did_you_mean(name, names).strip()


def exact_pattern(name: str) -> str:
    """Return a name as a regex that matches it."""
    try:
        plain = re.fullmatch(name, name) is not None
    except re.error:
        plain = False
    return name if plain else re.escape(name)


def check_uid(uid: str, path: str, taken: Mapping[str, str]) -> list[Problem]:
    """Return what is wrong with an entity's uid; `taken` maps used uids to their locations."""
    if not uid.strip():
        return [Problem(path, "an entity needs a name (uid)")]
    if "/" in uid:
        message = f"uid {uid!r} must not contain '/', which separates it from its parts"
        return [Problem(path, message)]
    if uid in taken:
        return [Problem(path, f"uid {uid!r} is taken by {taken[uid]}; every entity needs its own")]
    return []


class Jointed(Protocol):
    """The part of `ParsedArticulation` that references need."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Its joints."""

    @property
    def link_names(self) -> tuple[str, ...]:
        """Its links."""

    @property
    def root_link_name(self) -> str:
        """The root link."""

    @property
    def site_names(self) -> tuple[str, ...]:
        """Its sites that have a name."""

    @property
    def mimic_ids(self) -> tuple[int, ...]:
        """Joints that follow another one."""

    @property
    def control_parts(self) -> dict[str, tuple[int, ...]]:
        """Part -> joints."""


Known = Mapping[str, Jointed | str | None]
"""Uid -> the articulation (None if unreadable), or another kind: "rigid object", "light"."""


@dataclass(frozen=True)
class Picked:
    """Joints, links and parts that a reference picks, as indices in the entity's order.

    Attributes:
        joints: By default all active joints (no mimic joints); empty if the entity is not an
            articulation.
        links: By default empty.
        parts: Control parts, by name.
    """

    joints: tuple[int, ...] = ()
    links: tuple[int, ...] = ()
    parts: tuple[str, ...] = ()


def pick(
    path: str, fields: Mapping[str, Any], known: Known, open_scene: bool = False
) -> tuple[Picked, list[Problem]]:
    """Resolve a reference to an entity.

    Args:
        path: Its key path; may be empty.
        fields: Its keys: ``uid`` and keys that pick joints or links.
        known: The declared entities.
        open_scene: Whether Python code may add entities, so that unknown ones are allowed.

    Returns:
        The picked joints and links (empty where wrong or unknown), and every mistake.
    """
    uid = str(fields.get("uid") or "")
    entity = known.get(uid)
    picked = Picked()
    if isinstance(entity, str):
        picked, problems = _pick_of_body(entity, uid, fields)
    elif entity is not None:
        picked, problems = _pick_of_articulation(entity, uid, fields)
    elif uid in known or (open_scene and uid):
        problems = []
    else:
        there = [name for name, what in known.items() if what != "light"]
        what = f"no entity is called {uid!r}" if uid else "name an entity"
        hint = did_you_mean(uid, there).strip()
        problems = [Problem("uid", f"{what}; there are: {listing(there, uid)}", hint)]
    return Picked() if problems else picked, [p.below(path) for p in problems]


def _pick_of_articulation(
    entity: Jointed, uid: str, fields: Mapping[str, Any]
) -> tuple[Picked, list[Problem]]:
    names, there = entity.joint_names, list(entity.control_parts)
    active = [i for i in range(len(names)) if i not in entity.mimic_ids]
    parts, problems = _matching("control_parts", fields, there, "control part", uid)
    joints, found = _matching("joint_names", fields, names, "joint", uid)
    problems += found
    ids, found = _numbered("joint_ids", fields, len(names), "joints", uid)
    problems += found
    if ids is None and parts is None and joints is None:
        ids = active
    elif ids is None:
        of_parts = [i for part in parts or () for i in entity.control_parts[there[part]]]
        ids = _ordered([i for i in of_parts if i in active] + list(joints or ()), fields)
        if not ids and not problems:
            key = "joint_names" if parts is None else "control_parts"
            problems.append(Problem(key, f"picks no joint of {uid!r}; leave it out for all"))
    links, found = _links(entity.link_names, uid, fields)
    problems += found
    return Picked(tuple(ids), tuple(links), tuple(there[i] for i in parts or ())), problems


def _pick_of_body(what: str, uid: str, fields: Mapping[str, Any]) -> tuple[Picked, list[Problem]]:
    if what == "light":
        return Picked(), [Problem("uid", f"{uid!r} is a light: terms act on robots and objects")]
    problems = [
        Problem(name, f"{uid!r} is a {what} without joints")
        for name in ("joint_names", "control_parts", "joint_ids")
        if fields.get(name)
    ]
    links, found = _links((uid,), uid, fields)
    return Picked(links=tuple(links)), problems + found


def _links(
    names: Sequence[str], uid: str, fields: Mapping[str, Any]
) -> tuple[list[int], list[Problem]]:
    ids, problems = _numbered("body_ids", fields, len(names), "links", uid)
    if ids is not None:
        return ids, problems
    bodies: list[int] = []
    for key in ("link_names", "body_names"):
        matched, found = _matching(key, fields, names, "link", uid)
        bodies += matched or ()
        problems += found
    return _ordered(bodies, fields), problems


def _matching(
    key: str, fields: Mapping[str, Any], names: Sequence[str], what: str, uid: str
) -> tuple[list[int] | None, list[Problem]]:
    """Indices of the names that each pattern matches, in the order of the patterns."""
    wanted = fields.get(key)
    if wanted is None:
        return None, []
    picked: list[int] = []
    problems: list[Problem] = []
    for pattern in [wanted] if isinstance(wanted, str) else wanted:
        found, wrong = match(str(pattern), names, f"{what} of {uid!r}", key)
        picked += found
        problems += wrong
    return picked, problems


def _numbered(
    key: str, fields: Mapping[str, Any], count: int, what: str, uid: str
) -> tuple[list[int] | None, list[Problem]]:
    """Check indices that are given directly."""
    ids = fields.get(key)
    wrong = [i for i in ids or () if not 0 <= i < count]
    if wrong:
        message = f"{uid!r} has {count} {what}, numbered from 0; got {wrong}"
        return [], [Problem(key, message)]
    return None if ids is None else list(ids), []


def _ordered(picked: list[int], fields: Mapping[str, Any]) -> list[int]:
    unique = list(dict.fromkeys(picked))
    return unique if fields.get("preserve_order") else sorted(unique)
