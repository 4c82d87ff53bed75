"""Names in configs: regexes over names in models, uids, and references to entities.

A reference picks joints, and frames of one kind: links, sites or geoms. `pick` resolves all of it;
`find_frame` resolves names that are one string, ``ENTITY/NAME``.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol

from embodichain.lab.sim.compiler.alternatives import unmatched_alternatives
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    import mujoco

__all__ = [
    "FRAME_KINDS",
    "GROUND",
    "SUN",
    "FrameAlias",
    "FrameKind",
    "Jointed",
    "Known",
    "KnownObject",
    "NamedBy",
    "ObjectModel",
    "Picked",
    "check_uid",
    "exact_pattern",
    "find_frame",
    "find_frame_of",
    "find_in_spec",
    "frame_in_model",
    "frame_names",
    "match",
    "match_every",
    "names_in_spec",
    "names_wrong_alias",
    "no_such",
    "pick",
]

GROUND = "default_plane"
"""Name of the ground plane, EmbodiChain's."""
SUN = "default"
"""Name of the light of a scene that declares none."""
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
        ids = tuple(i for i, name in enumerate(names) if re.fullmatch(pattern, name))
    except re.error as error:
        return (), [Problem(path, f"malformed regex {pattern!r}: {error}")]
    if ids:
        return ids, []
    message = f"no {what} matches {pattern!r}; there are: {listing(names, pattern)}"
    return (), [Problem(path, message, _closest(pattern, names))]


def match_every(
    pattern: str, names: Sequence[str], what: str, path: str
) -> tuple[tuple[int, ...], list[Problem]]:
    """Do as `match`, and report each alternative of a ``|`` that matches nothing."""
    ids, problems = match(pattern, names, what, path)
    if problems:
        return ids, problems
    for alternative in unmatched_alternatives(pattern, names):
        message = (
            f"no {what} matches the alternative {alternative!r} of {pattern!r}; "
            f"there are: {listing(names, alternative)}"
        )
        problems.append(Problem(path, message, _closest(alternative, names)))
    return ids, problems


def no_such(what: str, name: str, names: Sequence[str], path: str) -> Problem:
    """Return the problem that a name does not exist."""
    message = f"no {what} is called {name!r}; there are: {', '.join(names)}"
    return Problem(path, message, _closest(name, names))


def _closest(name: str, names: Sequence[str]) -> str:
    """A hint: the closest name, or that nothing is attached under the first part of the name."""
    first, slash, _ = name.partition("/")
    if slash and first.isidentifier() and not any(n.startswith(f"{first}/") for n in names):
        attached = dict.fromkeys(n.partition("/")[0] for n in names if "/" in n)
        return f"Nothing is attached as {first!r}.{did_you_mean(first, list(attached))}"
    return did_you_mean(name, names).strip()


def exact_pattern(name: str) -> str:
    """Return a name as a regex that matches it."""
    try:
        matches_itself = re.fullmatch(name, name) is not None
    except re.error:
        matches_itself = False
    return name if matches_itself else re.escape(name)


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


@dataclass(frozen=True)
class FrameAlias:
    """Frames of a robot under a name that its config gives.

    Attributes:
        kind: Their kind.
        frames: Their names in the file, in the order of the config; none if the config has a
            mistake there, which is reported once.
    """

    kind: FrameKind
    frames: tuple[str, ...]


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
    def aliases(self) -> Mapping[str, FrameAlias]:
        """Further names of its links, sites and geoms."""

    @property
    def mimic_ids(self) -> tuple[int, ...]:
        """Joints that follow another one."""

    @property
    def control_parts(self) -> dict[str, tuple[int, ...]]:
        """Part -> joints."""


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A model with a rigid object in it.

    Attributes:
        model: The model.
        body_id: The object's body.
        prefix: Names of the object's geoms and sites begin with it.
    """

    model: mujoco.MjModel
    body_id: int
    prefix: str

    def names(self, kind: Literal["site", "geom"]) -> tuple[str, ...]:
        """Return the names of the object's sites or geoms that have one, without the prefix."""
        model = self.model
        if kind == "site":
            elements = [model.site(i) for i in range(model.nsite)]
        else:
            elements = [model.geom(i) for i in range(model.ngeom)]
        root = model.body_rootid[self.body_id]
        names: list[str] = []
        for element in elements:
            owner = int(element.bodyid[0])
            is_of_world = owner == 0
            if element.name and not is_of_world and model.body_rootid[owner] == root:
                names.append(element.name.removeprefix(self.prefix))
        return tuple(names)


@dataclass(frozen=True)
class KnownObject:
    """A rigid object: one link, of its own name, with geoms and sites.

    Attributes:
        uid: The object.
        body: Its body in the compiled scene.
        prefix: Names of its geoms and sites in the compiled scene begin with it; references leave
            it out.
        compile_alone: Returns a model with the object; None if its config is wrong. Called only for
            references to geoms and sites.
    """

    uid: str
    body: str
    prefix: str
    compile_alone: Callable[[], ObjectModel | None] = field(repr=False)

    def names(self, kind: FrameKind) -> tuple[str, ...] | None:
        """Its frames of a kind that have a name; None if its config is wrong."""
        if kind == "link":
            return (self.uid,)
        alone = self.compile_alone()
        if alone is None:
            return None
        return alone.names(kind)


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
    if isinstance(entity, str):
        return uid
    if not isinstance(entity, KnownObject):
        return f"{uid}/{name}"
    if kind == "link":
        return entity.body
    return f"{entity.prefix}{name}"


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
    kinds: tuple[FrameKind, ...] = FRAME_KINDS
    wanted_name = name
    prefix, colon, rest = name.partition(":")
    for kind in FRAME_KINDS:
        if colon and prefix == kind:
            kinds = (kind,)
            wanted_name = rest

    names_of: dict[FrameKind, Sequence[str]] = {}
    for kind in kinds:
        names_of_kind = names(kind)
        if names_of_kind is None:
            return None, []
        if wanted_name in names_of_kind:
            return (kind, wanted_name), []
        names_of[kind] = names_of_kind

    first = kinds[0]
    what = f"no {first} of {uid!r} matches" if uid else f"no {first} is called"
    message = f"{what} {wanted_name!r}; there are: {listing(names_of[first], wanted_name)}"
    for kind in kinds[1:]:
        if names_of[kind]:
            message += f"; {kind}s: {listing(names_of[kind], wanted_name)}"
    all_names: list[str] = []
    for kind in kinds:
        all_names += names_of[kind]
    return None, [Problem(path, message, _closest(wanted_name, all_names))]


def find_frame_of(
    entity: Jointed | KnownObject | str, uid: str, name: str, path: str = ""
) -> tuple[tuple[FrameKind, str] | None, list[Problem]]:
    """Resolve the name of one frame of an entity, see `find_frame`; a robot's `names` are known.

    Args:
        entity: The entity.
        uid: Its uid.
        name: The name.
        path: Its key path.
    """
    aliases = _aliases_of(entity)
    alias = aliases.get(name)
    if alias is not None:
        if not alias.frames:
            return None, []
        if len(alias.frames) == 1:
            return (alias.kind, alias.frames[0]), []
        message = f"one {alias.kind} is wanted, {name!r} names {', '.join(alias.frames)}"
        return None, [Problem(path, message)]
    frame, problems = find_frame(name, lambda kind: frame_names(entity, uid, kind), path, uid)
    return frame, [_with_aliases(problem, name, aliases) for problem in problems]


def _aliases_of(entity: Jointed | KnownObject | str) -> Mapping[str, FrameAlias]:
    """Return the further names of an entity's frames; only articulations have some."""
    if isinstance(entity, (str, KnownObject)):
        return {}
    return entity.aliases


def _with_aliases(problem: Problem, name: str, aliases: Mapping[str, FrameAlias]) -> Problem:
    """Return the problem of a name that does not exist, with the further names that there are."""
    if not aliases:
        return problem
    hint = did_you_mean(name, list(aliases)).strip() or problem.hint
    return replace(problem, message=f"{problem.message}; names: {', '.join(aliases)}", hint=hint)


def names_in_spec(spec: mujoco.MjSpec, kind: FrameKind) -> Sequence[str]:
    """The names of a spec's links, sites or geoms; of links those of the world's are left out."""
    if kind == "link":
        return [body.name for body in spec.bodies[1:]]  # the first is the world
    elements = spec.sites if kind == "site" else spec.geoms
    return [element.name for element in elements if element.name]


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
    if entity is None:
        if uid in known or (open_scene and uid):
            return Picked(), []
        return Picked(), [_no_entity(uid, known).below(path)]
    aliases = _aliases_of(entity)
    if aliases:
        if names_wrong_alias(fields, entity):
            return Picked(), []
        fields, mistakes = _replace_aliases(fields, aliases)
        if mistakes:
            return Picked(), [problem.below(path) for problem in mistakes]
    reference = _Reference(uid, entity, fields)
    if isinstance(entity, (str, KnownObject)):
        picked, problems = _pick_of_body(reference, entity)
    else:
        picked, problems = _pick_of_articulation(reference, entity)
    if problems:
        return Picked(), [problem.below(path) for problem in problems]
    return picked, []


def names_wrong_alias(
    fields: Mapping[str, Any], entity: Jointed | KnownObject | str | None
) -> bool:
    """Return whether a reference has a name whose meaning in the robot's config is a mistake."""
    aliases = {} if entity is None else _aliases_of(entity)
    for key in itertools.chain(*_FRAME_KEYS.values()):
        for name in _as_list(fields.get(key) or []):
            if name in aliases and not aliases[name].frames:
                return True
    return False


def _replace_aliases(
    fields: Mapping[str, Any], aliases: Mapping[str, FrameAlias]
) -> tuple[Mapping[str, Any], list[Problem]]:
    """Return the keys of a reference with the file's names for those of the robot's config.

    A name of sites or geoms turns the key of links into theirs. Frames of several kinds are a
    problem.
    """
    replaced = dict(fields)
    for written_kind, keys in _FRAME_KEYS.items():
        for key in keys:
            value = fields.get(key)
            if key == "body_ids" or value is None:
                continue
            entries = _as_list(value)
            used = {name: aliases[name] for name in entries if name in aliases}
            if not used:
                continue
            kinds = {alias.kind for alias in used.values()}
            if len(used) < len(entries):
                kinds.add(written_kind)
            if len(kinds) > 1:
                words = ", ".join(f"{name} ({alias.kind}s)" for name, alias in used.items())
                message = f"a reference names links, sites or geoms, of one kind; these are {words}"
                return fields, [Problem(key, message)]
            frames: list[str] = []
            for entry in entries:
                alias = used.get(entry)
                if alias is None:
                    frames.append(str(entry))
                else:
                    frames += map(exact_pattern, alias.frames)
            kind = kinds.pop()
            if key == written_kind:  # the short key, of one frame
                if len(frames) > 1:
                    names = ", ".join(used[entries[0]].frames)
                    message = f"one {kind} is wanted, {entries[0]!r} names {names}"
                    return fields, [Problem(key, message)]
                del replaced[key]
                replaced[kind] = used[entries[0]].frames[0]
                continue
            del replaced[key]
            replaced[key if kind == written_kind else f"{kind}_names"] = frames
    return replaced, []


def _no_entity(uid: str, known: Known) -> Problem:
    """Return the problem that a reference names no entity of the scene."""
    uids = [name for name, entity in known.items() if entity != "light"]
    what = f"no entity is called {uid!r}" if uid else "name an entity"
    hint = did_you_mean(uid, uids).strip()
    return Problem("uid", f"{what}; there are: {listing(uids, uid)}", hint)


@dataclass(frozen=True)
class _Match:
    """One name or regex of a reference, and the indices of the names that it matches."""

    key: str
    text: str
    ids: tuple[int, ...]

    def named_by(self, names: Sequence[str]) -> NamedBy:
        """Return the entry with the names that it picks."""
        return NamedBy(self.key, self.text, tuple(names[i] for i in self.ids))


@dataclass(frozen=True)
class _Reference:
    """A reference as it is written, and the entity that it names.

    Attributes:
        uid: The entity's name.
        entity: The entity.
        fields: The keys of the reference.
    """

    uid: str
    entity: Jointed | KnownObject | str
    fields: Mapping[str, Any]

    def match_names(
        self, key: str, names: Sequence[str], what: str
    ) -> tuple[list[_Match] | None, list[Problem]]:
        """Match each name or regex of a key; None if the reference does not have the key."""
        if self.fields.get(key) is None:
            return None, []
        matches: list[_Match] = []
        problems: list[Problem] = []
        for pattern in _as_list(self.fields[key]):
            # The short key is one name as it is, which may hold characters of a regex.
            if key == what and pattern in names:
                return [_Match(key, pattern, (names.index(pattern),))], []
            ids, mistakes = match_every(str(pattern), names, f"{what} of {self.uid!r}", key)
            matches.append(_Match(key, str(pattern), ids))
            problems += mistakes
        return matches, problems

    def read_numbers(
        self, key: str, count: int, what: str
    ) -> tuple[list[int] | None, list[Problem]]:
        """Check indices that are written as numbers; None if the reference has none."""
        ids = self.fields.get(key)
        if ids is None:
            return None, []
        wrong_ids = [i for i in ids if not 0 <= i < count]
        if wrong_ids:
            message = f"{self.uid!r} has {count} {what}, numbered from 0; got {wrong_ids}"
            return [], [Problem(key, message)]
        return list(ids), []

    def sort(self, ids: Sequence[int]) -> tuple[int, ...]:
        """Return each index once: in the entity's order, or as written with `preserve_order`."""
        unique = list(dict.fromkeys(ids))
        if not self.fields.get("preserve_order"):
            unique.sort()
        return tuple(unique)

    def frame_keys(self) -> dict[FrameKind, list[str]]:
        """Return the keys that name frames, by their kind."""
        keys_of: dict[FrameKind, list[str]] = {}
        for kind, keys in _FRAME_KEYS.items():
            keys_of[kind] = [key for key in keys if self.fields.get(key) is not None]
        return keys_of

    def with_other_kind(self, problem: Problem, key: str, kind: FrameKind) -> Problem:
        """Return a problem with the other kind of which a frame has the name, if there is one."""
        for other in FRAME_KINDS:
            if other == kind:
                continue
            names = frame_names(self.entity, self.uid, other) or ()
            for value in _as_list(self.fields[key]):
                name = str(value)
                if name in names and name in problem.message:
                    hint = f"A {other} is called so: write {other}: {name}, or {other}_names."
                    return Problem(problem.path, problem.message, hint)
        return problem


def _as_list(value: Any) -> Sequence[Any]:
    """Return a list as it is, and one name as a list."""
    return [value] if isinstance(value, str) else value


def _pick_of_articulation(
    reference: _Reference, articulation: Jointed
) -> tuple[Picked, list[Problem]]:
    joint_names = articulation.joint_names
    part_names = list(articulation.control_parts)
    active = [i for i in range(len(joint_names)) if i not in articulation.mimic_ids]
    part_matches, problems = reference.match_names("control_parts", part_names, "control part")
    joint_matches, mistakes = reference.match_names("joint_names", joint_names, "joint")
    problems += mistakes
    numbers, mistakes = reference.read_numbers("joint_ids", len(joint_names), "joints")
    problems += mistakes

    parts = [part_names[i] for part_match in part_matches or () for i in part_match.ids]
    joints: tuple[int, ...]
    joints_by: list[NamedBy] = []
    if numbers is not None:
        joints = tuple(numbers)
        joints_by = [NamedBy("joint_ids", str(i), (joint_names[i],)) for i in numbers]
    elif part_matches is None and joint_matches is None:
        joints = tuple(active)
    else:
        picked: list[int] = []
        for part in parts:
            of_part = [i for i in articulation.control_parts[part] if i in active]
            picked += of_part
            names = tuple(joint_names[i] for i in of_part)
            joints_by.append(NamedBy("control_parts", part, names))
        for joint_match in joint_matches or ():
            picked += joint_match.ids
            joints_by.append(joint_match.named_by(joint_names))
        joints = reference.sort(picked)
        has_empty_part = any(not articulation.control_parts[part] for part in parts)
        if not joints and not problems and not has_empty_part:  # an empty part is reported itself
            key = "joint_names" if part_matches is None else "control_parts"
            message = f"picks no joint of {reference.uid!r}; leave it out for all"
            problems.append(Problem(key, message))

    frames, mistakes = _pick_frames(reference)
    problems += mistakes
    return replace(frames, joints=joints, parts=tuple(parts), joints_by=tuple(joints_by)), problems


def _pick_of_body(reference: _Reference, entity: KnownObject | str) -> tuple[Picked, list[Problem]]:
    uid = reference.uid
    what = "rigid object" if isinstance(entity, KnownObject) else entity
    if what == "light":
        return Picked(), [Problem("uid", f"{uid!r} is a light: terms act on robots and objects")]
    problems = [
        Problem(key, f"{uid!r} is a {what} without joints")
        for key in ("joint_names", "control_parts", "joint_ids")
        if reference.fields.get(key)
    ]
    frames, mistakes = _pick_frames(reference)
    return frames, problems + mistakes


def _last_quoted(problem: Problem) -> str:
    """Return the name that a message says in quotes, without the entity's; empty if none."""
    quoted = re.findall(r"'([^']*)'", problem.message.partition("; there are:")[0])
    return quoted[-1] if quoted else ""


def _pick_frames(reference: _Reference) -> tuple[Picked, list[Problem]]:
    """The picked links, sites or geoms."""
    keys_of = reference.frame_keys()
    kinds = [kind for kind in FRAME_KINDS if keys_of[kind]]
    if len(kinds) > 1:
        first = keys_of[kinds[0]][0]
        second = keys_of[kinds[1]][0]
        message = f"{first} is given as well: a reference names links, sites or geoms, of one kind"
        return Picked(), [Problem(second, message)]
    kind = kinds[0] if kinds else "link"
    keys = keys_of[kind]
    first_key = keys[0] if keys else "link_names"
    if kind in keys and len(keys) > 1:
        other = next(key for key in keys if key != kind)
        return Picked(), [Problem(kind, f"{other} is given as well: leave one of them out")]

    names = frame_names(reference.entity, reference.uid, kind)
    if names is None:
        return Picked(kind=kind, key=first_key), []
    numbers, problems = reference.read_numbers("body_ids", len(names), "links")
    if numbers is not None:
        by_number = tuple(NamedBy("body_ids", str(i), (names[i],)) for i in numbers)
        frames = Picked(kind=kind, frames=tuple(numbers), key=first_key, frames_by=by_number)
        return frames, problems

    picked: list[int] = []
    frames_by: list[NamedBy] = []
    for key in keys:
        matches, mistakes = reference.match_names(key, names, kind)
        ids = [i for frame_match in matches or () for i in frame_match.ids]
        if key == kind and len(ids) > 1:
            matching = ", ".join(names[i] for i in ids)
            mistakes.append(Problem(key, f"one {kind} is wanted, these match: {matching}"))
        if kind != "link" and not ids and not mistakes:
            mistakes.append(Problem(key, f"names no {kind}; leave it out for the root"))
        picked += ids
        frames_by += [frame_match.named_by(names) for frame_match in matches or ()]
        problems += [reference.with_other_kind(problem, key, kind) for problem in mistakes]
    aliases = _aliases_of(reference.entity)
    if aliases:
        problems = [_with_aliases(problem, _last_quoted(problem), aliases) for problem in problems]
    frames = Picked(
        kind=kind,
        frames=reference.sort(picked),
        key=first_key,
        frames_by=tuple(frames_by),
    )
    return frames, problems
