"""What a reference to an entity picks: joints, links, control parts, by name or by number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from embodichain.lab.sim.compiler.articulation import ParsedArticulation
from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["Known", "Picked", "check_reference", "pick"]

Known = Mapping[str, ParsedArticulation | str | None]
"""Uid -> the articulation (None: unreadable), or what else it is: "rigid object", "light"."""


@dataclass(frozen=True)
class Picked:
    """What a reference picks of an entity, as indices in the entity's order.

    Attributes:
        joints: Without a choice all active joints (no mimic joints); none of what is no
            articulation.
        links: Without a choice none.
        parts: Control parts, by name.
    """

    joints: tuple[int, ...] = ()
    links: tuple[int, ...] = ()
    parts: tuple[str, ...] = ()


def check_reference(
    path: str, fields: Mapping[str, Any], known: Known, open_scene: bool
) -> list[Problem]:
    """Return what is wrong with one reference; see `pick`."""
    return pick(path, fields, known, open_scene)[1]


def pick(
    path: str, fields: Mapping[str, Any], known: Known, open_scene: bool = False
) -> tuple[Picked, list[Problem]]:
    """Look up what a reference means.

    Args:
        path: Its key path; empty is none.
        fields: Its keys: ``uid`` and any of those that pick joints or links.
        known: The declared entities.
        open_scene: Whether Python code may add entities: an unknown one is then no mistake.

    Returns:
        What it picks, nothing where something is wrong or unknown, and every mistake.
    """
    uid = str(fields.get("uid") or "")
    entity = known.get(uid)
    if isinstance(entity, ParsedArticulation):
        picked, problems = _pick_of(entity, uid, fields)
    elif entity is not None:
        picked, problems = Picked(), _check_plain(uid, entity, fields)
    elif uid in known or (open_scene and uid):
        return Picked(), []
    else:
        there = [name for name, what in known.items() if what != "light"]
        what = f"no entity is called {uid!r}" if uid else "name an entity"
        hint = did_you_mean(uid, there).strip()
        picked, problems = (
            Picked(),
            [Problem("uid", f"{what}; there are: {listing(there, uid)}", hint)],
        )
    if path:
        problems = [Problem(f"{path}.{p.path}", p.message, p.hint) for p in problems]
    return Picked() if problems else picked, problems


def _pick_of(
    entity: ParsedArticulation, uid: str, fields: Mapping[str, Any]
) -> tuple[Picked, list[Problem]]:
    """Joints and links of an articulation."""
    names, links = entity.joint_names, entity.link_names
    active = [i for i in range(len(names)) if i not in set(map(int, entity.mimic_ids))]
    there = list(entity.control_parts)
    parts, problems = _matching("control_parts", fields, there, "control part", uid)
    joints, found = _matching("joint_names", fields, names, "joint", uid)
    problems += found
    ids, found = _numbered("joint_ids", fields, len(names), "joints", uid)
    problems += found
    of_parts = [i for part in parts or () for i in entity.control_parts[there[part]]]
    chosen = [i for i in of_parts if i in active] + list(joints or ())
    if ids is not None:
        picked = ids
    elif parts is None and joints is None:
        picked = active
    else:
        picked = _ordered(chosen, fields)
        if not picked and not problems:
            key = "joint_names" if parts is None else "control_parts"
            problems.append(Problem(key, f"picks no joint of {uid!r}; leave it out for all"))
    bodies, found = _numbered("body_ids", fields, len(links), "links", uid)
    problems += found
    if bodies is None:
        bodies = []
        for key in ("link_names", "body_names"):
            matched, found = _matching(key, fields, links, "link", uid)
            bodies += matched or ()
            problems += found
        bodies = _ordered(bodies, fields)
    return Picked(tuple(picked), tuple(bodies), tuple(there[i] for i in parts or ())), problems


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
    """Indices that are given as such."""
    ids = fields.get(key)
    wrong = [i for i in ids or () if not 0 <= i < count]
    if wrong:
        message = f"{uid!r} has {count} {what}, numbered from 0; got {wrong}"
        return [], [Problem(key, message)]
    return None if ids is None else list(ids), []


def _ordered(picked: list[int], fields: Mapping[str, Any]) -> list[int]:
    unique = list(dict.fromkeys(picked))
    return unique if fields.get("preserve_order") else sorted(unique)


def _check_plain(uid: str, what: str, fields: Mapping[str, Any]) -> list[Problem]:
    """Check a reference to something that is no articulation."""
    if what == "light":
        return [Problem("uid", f"{uid!r} is a light: terms act on robots and objects")]
    problems = [
        Problem(name, f"{uid!r} is a {what} without joints")
        for name in ("joint_names", "control_parts", "joint_ids")
        if fields.get(name)
    ]
    for name in ("link_names", "body_names"):
        problems += _matching(name, fields, (uid,), "link", uid)[1]
    return problems
