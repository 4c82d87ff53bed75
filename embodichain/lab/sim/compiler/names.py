"""Names in configs: regexes over names in models, uids, and references to entities.

A reference picks joints, and frames of one kind: links, sites or geoms. `pick` resolves all of it;
`find_frame` resolves names that are one string, ``ENTITY/NAME``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol

from embodichain.lab.sim.compiler.alternatives import unmatched_alternatives
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    import mujoco

__all__ = [
    "FRAME_KINDS",
    "GROUND",
    "FrameKind",
    "Jointed",
    "Known",
    "KnownObject",
    "NamedBy",
    "Picked",
    "check_uid",
    "exact_pattern",
    "find_frame",
    "find_in_spec",
    "frame_in_model",
    "frame_names",
    "match",
    "match_every",
    "names_in_spec",
    "no_such",
    "pick",
]

GROUND = "default_plane"
"""Name of the ground plane, EmbodiChain's."""
FrameKind = Literal["link", "site", "geom"]
"""What a reference names beside joints: bodies, or sites or geoms that are fixed on them."""
FRAME_KINDS: tuple[FrameKind, ...] = ("link", "site", "geom")
_FRAME_KEYS: dict[FrameKind, tuple[str, ...]] = {
    "link": ("link_names", "body_names", "link", "body_ids"),
    "site": ("site_names", "site"),
    "geom": ("geom_names", "geom"),
}
"""Keys of a reference that pick frames of a kind."""


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


def match_every(
    pattern: str, names: Sequence[str], what: str, path: str
) -> tuple[tuple[int, ...], list[Problem]]:
    """Do as `match`, and report each alternative of a ``|`` that matches nothing."""
    found, problems = match(pattern, names, what, path)
    if problems:
        return found, problems
    return found, [
        Problem(
            path,
            f"no {what} matches the alternative {one!r} of {pattern!r}; "
            f"there are: {listing(names, one)}",
            _closest(one, names),
        )
        for one in unmatched_alternatives(pattern, names)
    ]


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
    def geom_names(self) -> tuple[str, ...]:
        """Its geoms that have a name."""

    @property
    def mimic_ids(self) -> tuple[int, ...]:
        """Joints that follow another one."""

    @property
    def control_parts(self) -> dict[str, tuple[int, ...]]:
        """Part -> joints."""


@dataclass(frozen=True)
class KnownObject:
    """A rigid object: one link, of its own name, with geoms and sites.

    Attributes:
        uid: The object.
        body: Its body in the compiled scene.
        prefix: Names of its geoms and sites in the compiled scene begin with it; references leave
            it out.
        alone: Returns a model with the object, the id of its body there, and the prefix of names
            there; None if its config is wrong. Called only for references to geoms and sites.
    """

    uid: str
    body: str
    prefix: str
    alone: Callable[[], tuple[mujoco.MjModel, int, str] | None]

    def names(self, kind: FrameKind) -> tuple[str, ...] | None:
        """Its frames of a kind that have a name; None if its config is wrong."""
        if kind == "link":
            return (self.uid,)
        compiled = self.alone()
        if compiled is None:
            return None
        model, top, prefix = compiled
        owner = model.site_bodyid if kind == "site" else model.geom_bodyid
        count = model.nsite if kind == "site" else model.ngeom
        one = model.site if kind == "site" else model.geom
        root = model.body_rootid
        found = [one(i).name for i in range(count) if root[owner[i]] == root[top] and owner[i]]
        return tuple(name.removeprefix(prefix) for name in found if name)


Known = Mapping[str, Jointed | KnownObject | str | None]
"""Uid -> the articulation (None if unreadable), the object, or another kind: "light"."""


@dataclass(frozen=True)
class NamedBy:
    """One entry of a reference, as written, and what it picks.

    Attributes:
        key: The key that contains it: ``joint_names``.
        text: A name, a regex, a control part, or a number.
        names: The names that it picks.
    """

    key: str
    text: str
    names: tuple[str, ...]

    @property
    def is_part(self) -> bool:
        """Whether it is a control part: a declared group of joints, no regex."""
        return self.key == "control_parts"


@dataclass(frozen=True)
class Picked:
    """Joints, frames and parts that a reference picks, as indices in the entity's order.

    Attributes:
        joints: By default all active joints (no mimic joints); empty if the entity is not an
            articulation.
        kind: The kind of the frames.
        frames: Links, sites or geoms; by default none.
        key: The key that names them.
        parts: Control parts, by name.
        joints_by: The entries that name joints, in the order of the file; none picks all.
        frames_by: The entries that name frames, likewise.
    """

    joints: tuple[int, ...] = ()
    kind: FrameKind = "link"
    frames: tuple[int, ...] = ()
    key: str = "link_names"
    parts: tuple[str, ...] = ()
    joints_by: tuple[NamedBy, ...] = ()
    frames_by: tuple[NamedBy, ...] = ()


def frame_names(
    entity: Jointed | KnownObject | str, uid: str, kind: FrameKind
) -> tuple[str, ...] | None:
    """The names of an entity's frames of a kind; None if they are not known."""
    if isinstance(entity, str):
        return (uid,) if kind == "link" else ()
    if isinstance(entity, KnownObject):
        return entity.names(kind)
    return getattr(entity, f"{kind}_names")


def frame_in_model(
    entity: Jointed | KnownObject | str, uid: str, kind: FrameKind, name: str
) -> str:
    """The name in the compiled scene of an entity's frame."""
    if isinstance(entity, KnownObject):
        return entity.body if kind == "link" else f"{entity.prefix}{name}"
    return uid if isinstance(entity, str) else f"{uid}/{name}"


def find_frame(
    name: str, names: Callable[[FrameKind], Sequence[str] | None], path: str, uid: str = ""
) -> tuple[tuple[FrameKind, str] | None, list[Problem]]:
    """Resolve a name without a kind: a link's, else a site's, else a geom's.

    ``site:NAME`` and ``geom:NAME`` (or ``link:NAME``) say which, where several have the name.

    Args:
        name: The name.
        names: Returns the names of a kind; None if they are not known.
        path: Its key path.
        uid: The entity, for messages.

    Returns:
        Kind and name (None if there is no such frame, or names are not known), and the problem.
    """
    prefix, colon, rest = name.partition(":")
    said = next((kind for kind in FRAME_KINDS if colon and prefix == kind), None)
    wanted, kinds = (rest, (said,)) if said is not None else (name, FRAME_KINDS)
    there: dict[FrameKind, Sequence[str]] = {}
    for kind in kinds:
        own = names(kind)
        if own is None:
            return None, []
        if wanted in own:
            return (kind, wanted), []
        there[kind] = own
    first = kinds[0]
    what = f"no {first} of {uid!r} matches" if uid else f"no {first} is called"
    message = f"{what} {wanted!r}; there are: {listing(there[first], wanted)}"
    for kind in kinds[1:]:
        message += f"; {kind}s: {listing(there[kind], wanted)}" if there[kind] else ""
    every = [one for own in there.values() for one in own]
    return None, [Problem(path, message, _closest(wanted, every))]


def names_in_spec(spec: mujoco.MjSpec, kind: FrameKind) -> Sequence[str]:
    """The names of a spec's links, sites or geoms; of links those of the world's are left out."""
    if kind == "link":
        return [body.name for body in spec.bodies[1:]]  # the first is the world
    return [one.name for one in (spec.sites if kind == "site" else spec.geoms) if one.name]


def find_in_spec(
    spec: mujoco.MjSpec, name: str, path: str
) -> tuple[tuple[FrameKind, str] | None, list[Problem]]:
    """Resolve a name without a kind, see `find_frame`."""
    return find_frame(name, lambda kind: names_in_spec(spec, kind), path)


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
        The picked joints and frames (empty where wrong or unknown), and every mistake.
    """
    uid = str(fields.get("uid") or "")
    entity = known.get(uid)
    picked = Picked()
    if isinstance(entity, (str, KnownObject)):
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
    by: list[NamedBy] = []
    chosen = [there[i] for _, hits in parts or () for i in hits]
    if ids is not None:
        by = [NamedBy("joint_ids", str(i), (names[i],)) for i in ids]
    elif parts is None and joints is None:
        ids = active
    else:
        of_parts = {p: [i for i in entity.control_parts[p] if i in active] for p in chosen}
        by = [NamedBy("control_parts", p, _named(of_parts[p], names)) for p in chosen]
        by += [NamedBy("joint_names", text, _named(hits, names)) for text, hits in joints or ()]
        picked = [i for own in of_parts.values() for i in own] + _flat(joints)
        ids = _ordered(picked, fields)
        if not ids and not problems:
            key = "joint_names" if parts is None else "control_parts"
            problems.append(Problem(key, f"picks no joint of {uid!r}; leave it out for all"))
    frames, found = _frames(entity, uid, fields)
    picked_all = replace(frames, joints=tuple(ids), parts=tuple(chosen), joints_by=tuple(by))
    return picked_all, problems + found


def _pick_of_body(
    entity: KnownObject | str, uid: str, fields: Mapping[str, Any]
) -> tuple[Picked, list[Problem]]:
    what = "rigid object" if isinstance(entity, KnownObject) else entity
    if what == "light":
        return Picked(), [Problem("uid", f"{uid!r} is a light: terms act on robots and objects")]
    problems = [
        Problem(name, f"{uid!r} is a {what} without joints")
        for name in ("joint_names", "control_parts", "joint_ids")
        if fields.get(name)
    ]
    frames, found = _frames(entity, uid, fields)
    return frames, problems + found


def _frames(
    entity: Jointed | KnownObject | str, uid: str, fields: Mapping[str, Any]
) -> tuple[Picked, list[Problem]]:
    """The picked links, sites or geoms."""
    given = {k: [key for key in keys if fields.get(key) is not None] for k, keys in _KEYS}
    kinds = [kind for kind, keys in given.items() if keys]
    if len(kinds) > 1:
        first, second = given[kinds[0]][0], given[kinds[1]][0]
        message = f"{first} is given as well: a reference names links, sites or geoms, of one kind"
        return Picked(), [Problem(second, message)]
    kind = kinds[0] if kinds else "link"
    key = given[kind][0] if kinds else "link_names"
    if kind in given[kind] and len(given[kind]) > 1:
        other = next(key for key in given[kind] if key != kind)
        return Picked(), [Problem(kind, f"{other} is given as well: leave one of them out")]
    names = frame_names(entity, uid, kind)
    if names is None:
        return Picked(kind=kind, key=key), []
    ids, problems = _numbered("body_ids", fields, len(names), "links", uid)
    if ids is not None:
        numbers = tuple(NamedBy("body_ids", str(i), (names[i],)) for i in ids)
        return Picked(kind=kind, frames=tuple(ids), key=key, frames_by=numbers), problems
    picked: list[int] = []
    by: list[NamedBy] = []
    for name in given[kind]:
        entries, found = _matching(name, fields, names, kind, uid)
        matched = None if entries is None else _flat(entries)
        by += [NamedBy(name, text, _named(hits, names)) for text, hits in entries or ()]
        if name == kind and len(matched or ()) > 1:
            matching = ", ".join(names[i] for i in matched or ())
            found.append(Problem(name, f"one {kind} is wanted, these match: {matching}"))
        picked += matched or ()
        problems += [_with_other_kind(p, entity, uid, fields[name], kind) for p in found]
        if kind != "link" and matched == [] and not found:
            problems.append(Problem(name, f"names no {kind}; leave it out for the root"))
    ordered = tuple(_ordered(picked, fields))
    return Picked(kind=kind, frames=ordered, key=key, frames_by=tuple(by)), problems


_KEYS = _FRAME_KEYS.items()


def _with_other_kind(
    problem: Problem,
    entity: Jointed | KnownObject | str,
    uid: str,
    wanted: Any,
    kind: FrameKind,
) -> Problem:
    """The problem, with the other kind of which a frame has the name, if there is one."""
    wanted = [wanted] if isinstance(wanted, str) else wanted
    for other in FRAME_KINDS:
        there = () if other == kind else frame_names(entity, uid, other) or ()
        called = [str(name) for name in wanted if str(name) in there and name in problem.message]
        if called:
            keys = f"{other}: {called[0]}, or {other}_names"
            return Problem(problem.path, problem.message, f"A {other} is called so: write {keys}.")
    return problem


_Entries = list[tuple[str, tuple[int, ...]]]
"""Entries of a list of names, and the indices of what each matches."""


def _matching(
    key: str, fields: Mapping[str, Any], names: Sequence[str], what: str, uid: str
) -> tuple[_Entries | None, list[Problem]]:
    """Each name or regex of a key with the indices of the names that it matches."""
    wanted = fields.get(key)
    if wanted is None:
        return None, []
    entries: _Entries = []
    problems: list[Problem] = []
    for pattern in [wanted] if isinstance(wanted, str) else wanted:
        if key == what and pattern in names:  # one name, as it is
            return [(pattern, (names.index(pattern),))], []
        found, wrong = match_every(str(pattern), names, f"{what} of {uid!r}", key)
        entries.append((str(pattern), found))
        problems += wrong
    return entries, problems


def _flat(entries: _Entries | None) -> list[int]:
    return [i for _, hits in entries or () for i in hits]


def _named(ids: Sequence[int], names: Sequence[str]) -> tuple[str, ...]:
    return tuple(names[i] for i in ids)


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
