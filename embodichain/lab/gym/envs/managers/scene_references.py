"""References to entities in the parameters of a task's terms: whether what they name exists."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from embodichain.lab.gym.envs.managers.registry import SECTIONS
from embodichain.lab.sim.compiler.names import Known, pick
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["check_references"]

_LIGHT_TERMS = frozenset({"randomize_light"})
"""Terms whose entity is a light."""

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
_KEY = re.compile(r"(.*_)?(entity_cfg|cfg|relative_to)|of|from|to")


def check_references(cfg: Any, known: Known, open_scene: bool) -> list[Problem]:
    """Return every reference to an entity, joint, link or control part that does not exist.

    A parameter is a reference if it is a `SceneEntityCfg`, or a map with nothing but its keys that
    has ``uid`` or whose own key says so (``of``, ``from``, ``to``, ``..._cfg``, ``relative_to``).

    Args:
        cfg: The task.
        known: The declared entities.
        open_scene: Whether Python code may add entities: an unknown uid is then no mistake.
    """
    problems: list[Problem] = []
    for section in SECTIONS:
        for name, term in getattr(cfg, section).items():
            for path, fields in _references(f"{section}.{name}.params", term.params):
                if term.func in _LIGHT_TERMS:
                    problems += _check_light(path, str(fields.get("uid") or ""), known, open_scene)
                else:
                    problems += pick(path, fields, known, open_scene)[1]
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
