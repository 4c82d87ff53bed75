"""References to entities in the parameters of terms: uids, joints, links, control parts."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from embodichain.lab.sim.compiler.articulation import ParsedArticulation
from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["TERM_SECTIONS", "Known", "check_reference", "check_references"]

TERM_SECTIONS = (
    "commands",
    "actions",
    "events",
    "observations",
    "rewards",
    "terminations",
    "metrics",
    "curriculum",
)

LIGHT_TERMS = frozenset({"randomize_light"})
"""Terms whose entity is a light."""

Known = Mapping[str, ParsedArticulation | str | None]
"""Uid -> the articulation (None: unreadable), or what else it is: "rigid object", "light"."""

_FIELDS = frozenset(
    {
        "uid",
        "joint_names",
        "link_names",
        "body_names",
        "control_parts",
        "preserve_order",
        "joint_ids",
        "body_ids",
    }
)
_KEY = re.compile(r"(.*_)?(entity_cfg|cfg|relative_to)")


def check_references(cfg: Any, known: Known, open_scene: bool) -> list[Problem]:
    """Return every reference to an entity, joint, link or control part that does not exist.

    A parameter is a reference if it is a `SceneEntityCfg`, or a map with nothing but its keys that
    has ``uid`` or whose own key says so (``entity_cfg``, ``..._cfg``, ``relative_to``).

    Args:
        cfg: The task.
        known: The declared entities.
        open_scene: Whether Python code may add entities: an unknown uid is then no mistake.
    """
    problems: list[Problem] = []
    for section in TERM_SECTIONS:
        for name, term in getattr(cfg, section).items():
            for path, fields in _references(f"{section}.{name}.params", term.params):
                if term.func in LIGHT_TERMS:
                    problems += _check_light(path, str(fields.get("uid") or ""), known, open_scene)
                else:
                    problems += check_reference(path, fields, known, open_scene)
    return problems


def _check_light(path: str, uid: str, known: Known, open_scene: bool) -> list[Problem]:
    lights = [name for name, what in known.items() if what == "light"]
    if uid in lights or (open_scene and uid and uid not in known):
        return []
    message = f"no light is called {uid!r}; there are: {listing(lights, uid)}"
    return [Problem(f"{path}.uid", message, did_you_mean(uid, lights).strip())]


def _references(path: str, params: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    items: Iterator[tuple[Any, Any]] = iter(())
    if isinstance(params, Mapping):
        items = iter(params.items())
    elif isinstance(params, (list, tuple)):
        items = iter(enumerate(params))
    for key, value in items:
        where = f"{path}.{key}"
        fields = _fields(str(key), value)
        if fields is not None:
            yield where, fields
        else:
            yield from _references(where, value)


def _fields(key: str, value: Any) -> dict[str, Any] | None:
    """Return a reference's fields, or None if the value is no reference."""
    if isinstance(value, Mapping):
        if ("uid" in value or _KEY.fullmatch(key)) and _FIELDS.issuperset(value):
            return dict(value)
        return None
    if hasattr(value, "uid") and hasattr(value, "joint_names") and hasattr(value, "body_ids"):
        return {name: getattr(value, name) for name in _FIELDS}
    return None


def check_reference(
    path: str, fields: Mapping[str, Any], known: Known, open_scene: bool
) -> list[Problem]:
    """Return what is wrong with one reference; see `check_references`.

    Args:
        path: Its key path.
        fields: Its keys: ``uid`` and any of those that pick joints or links.
        known: The declared entities.
        open_scene: Whether Python code may add entities.
    """
    uid = str(fields.get("uid") or "")
    if uid not in known:
        if open_scene and uid:
            return []
        there = [name for name, what in known.items() if what != "light"]
        what = f"no entity is called {uid!r}" if uid else "name an entity"
        hint = did_you_mean(uid, there).strip()
        return [Problem(f"{path}.uid", f"{what}; there are: {listing(there, uid)}", hint)]
    entity = known[uid]
    if entity is None:
        return []
    if isinstance(entity, str):
        return _check_plain(path, uid, entity, fields)
    problems: list[Problem] = []
    for name, names, what in (
        ("joint_names", entity.joint_names, "joint"),
        ("link_names", entity.link_names, "link"),
        ("body_names", entity.link_names, "link"),
        ("control_parts", tuple(entity.control_parts), "control part"),
    ):
        problems += _check_names(f"{path}.{name}", fields.get(name), names, f"{what} of {uid!r}")
    for name, count, what in (
        ("joint_ids", len(entity.joint_names), "joints"),
        ("body_ids", len(entity.link_names), "links"),
    ):
        wrong = [i for i in fields.get(name) or () if not 0 <= i < count]
        if wrong:
            message = f"{uid!r} has {count} {what}, numbered from 0; got {wrong}"
            problems.append(Problem(f"{path}.{name}", message))
    return problems


def _check_plain(path: str, uid: str, what: str, fields: Mapping[str, Any]) -> list[Problem]:
    """Check a reference to something that is no articulation."""
    if what == "light":
        return [Problem(f"{path}.uid", f"{uid!r} is a light: terms act on robots and objects")]
    problems = [
        Problem(f"{path}.{name}", f"{uid!r} is a {what} without joints")
        for name in ("joint_names", "control_parts", "joint_ids")
        if fields.get(name)
    ]
    for name in ("link_names", "body_names"):
        problems += _check_names(f"{path}.{name}", fields.get(name), (uid,), f"link of {uid!r}")
    return problems


def _check_names(path: str, wanted: Any, names: Sequence[str], what: str) -> list[Problem]:
    if wanted is None:
        return []
    problems: list[Problem] = []
    for pattern in [wanted] if isinstance(wanted, str) else wanted:
        problems += match(str(pattern), names, what, path)[1]
    return problems
