"""`with_present_names`: a digest in today's words, where a task calls the same things otherwise.

A robot that has another uid is the same robot if its bodies have the same names; whether they have
the same values is compared afterwards. A reference is the same one if it picks the same joints and
frames of the present scene, whatever words say so: ``link_names: [ee_link]`` and ``link: tool``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from embodichain.lab.gym.envs.managers.scene_entity import references_in
from embodichain.lab.sim.compiler.names import Known, Picked, pick
from embodichain.lab.sim.configs.references import REFERENCE_WORDS

__all__ = ["with_present_names"]


def with_present_names(
    before: Mapping[str, Any], now: Mapping[str, Any], known: Known
) -> dict[str, Any]:
    """Return a digest's parts with the uids and references of another digest.

    Args:
        before: The parts of a digest.
        now: Those of the present task.
        known: The entities of the present scene.
    """
    renamed: Any = before
    for earlier_uid, uid in _renamed_uids(before.get("model", {}), now.get("model", {})).items():
        renamed = _rename(renamed, earlier_uid, uid)
    return {part: _same_references(value, now.get(part), known) for part, value in renamed.items()}


def _renamed_uids(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, str]:
    """Return earlier uid -> present uid of entities of whose bodies only the prefix differs."""
    bodies_before = _bodies_by_uid(before)
    bodies_now = _bodies_by_uid(now)
    gone = {uid: names for uid, names in bodies_before.items() if uid not in bodies_now}
    new = {uid: names for uid, names in bodies_now.items() if uid not in bodies_before}
    renamed: dict[str, str] = {}
    for earlier_uid, names in gone.items():
        same_names = [uid for uid, present_names in new.items() if present_names == names]
        alike = [uid for uid, other_names in gone.items() if other_names == names]
        if len(same_names) == len(alike) == 1:
            renamed[earlier_uid] = same_names[0]
    return renamed


def _bodies_by_uid(model: Mapping[str, Any]) -> dict[str, set[str]]:
    """Return uid -> the names of its bodies, without the uid."""
    bodies: dict[str, set[str]] = {}
    for element in model:
        kind, _, name = element.partition(" ")
        uid, slash, body = name.partition("/")
        if kind == "body" and slash:
            bodies.setdefault(uid, set()).add(body)
    return bodies


def _rename(value: Any, earlier_uid: str, uid: str) -> Any:
    """Return a value with another uid in its names, and in its references."""
    before_slash = re.compile(rf"(?<![^\s,]){re.escape(earlier_uid)}/")

    def rename(item: Any) -> Any:
        if isinstance(item, str):
            return before_slash.sub(f"{uid}/", item)
        if isinstance(item, list):
            return [rename(entry) for entry in item]
        if not isinstance(item, Mapping):
            return item
        return {
            rename(key): uid if key == "uid" and entry == earlier_uid else rename(entry)
            for key, entry in item.items()
        }

    return rename(value)


def _same_references(before: Any, now: Any, known: Known) -> Any:
    """Return a value in which references that pick the same as those of another are theirs."""
    if not (isinstance(before, Mapping) and isinstance(now, Mapping)):
        return before
    if _is_reference(before) and _is_reference(now):
        earlier_choice = _choice(before, known)
        is_same = earlier_choice is not None and earlier_choice == _choice(now, known)
        return now if is_same else before
    same: dict[str, Any] = {}
    for key, value in before.items():
        present_key = key if key in now else REFERENCE_WORDS.get(key, key)  # as older digests have
        same[key] = _same_references(value, now.get(present_key), known)
    return same


def _is_reference(value: Mapping[str, Any]) -> bool:
    """Whether a map names an entity, and only it and its parts."""
    return "uid" in value and any(references_in("", {"of": value}))


def _choice(reference: Mapping[str, Any], known: Known) -> tuple[Any, ...] | None:
    """Return what a reference picks, in its order; None if it names something that is not there."""
    picked, problems = pick("", reference, known)
    if problems or picked == Picked():
        return None
    return reference["uid"], picked.joints, picked.kind, picked.frames
