"""Rigid objects, lights and sensors of a gym config."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from embodichain.compat.gym_config.draft import Draft, Path
from embodichain.compat.gym_config.vocabulary import (
    ATTR_GROUPS,
    ATTRS,
    LIGHT,
    LIGHTS,
    MATERIAL,
    RIGID_OBJECT,
    SENSORS,
    SHAPES,
)
from embodichain.utils.suggest import did_you_mean

__all__ = ["convert_attrs", "convert_lights", "convert_objects", "convert_sensors"]

_LIGHT_TYPES = ("point", "sun", "direction", "spot")
_OTHER_LIGHT_TYPES = ("rect", "mesh")


def convert_objects(draft: Draft, section: str, data: Any) -> None:
    """Convert `rigid_object`, or `background`, whose bodies are static unless they say otherwise.

    Args:
        draft: Grows by the objects.
        section: Which of the two.
        data: The list.
    """
    for source, item in draft.items(data, (section,)):
        target = draft.entity(item, source, "objects")
        if target is None or not draft.carry(item, source, target, RIGID_OBJECT):
            continue
        if item.get("shape") is not None:
            _shape(draft, item["shape"], (*source, "shape"), (*target, "shape"))
        if item.get("attrs") is not None:
            convert_attrs(draft, item["attrs"], (*source, "attrs"), (*target, "attrs"))
        _body_type(draft, section, item, source, target)


def convert_attrs(draft: Draft, data: Any, source: Path, target: Path) -> None:
    """Convert the attributes of a body: flat, or in the groups of release 0.3."""
    if not isinstance(data, Mapping):
        draft.carry(data, source, target, ATTRS)  # refuses it
        return
    flat = {k: v for k, v in data.items() if k not in ATTR_GROUPS}
    draft.carry(flat, source, target, ATTRS)
    for group in ATTR_GROUPS:
        if data.get(group) is not None:
            draft.carry(data[group], (*source, group), target, ATTRS)


def convert_lights(draft: Draft, data: Any) -> None:
    """Convert the section `light`: its direct lights."""
    if data is None or not draft.carry(data, ("light",), (), LIGHTS):
        return
    for source, item in draft.items(data.get("direct"), ("light", "direct")):
        kind = item.get("light_type") if isinstance(item, Mapping) else None
        if kind in _OTHER_LIGHT_TYPES:
            draft.note(source, f"lights of type {kind} are not drawn")
            continue
        target = draft.entity(item, source, "lights")
        if target is not None and draft.carry(item, source, target, LIGHT) and kind is not None:
            draft.put((*target, "light_type"), kind, (*source, "light_type"))


def convert_sensors(draft: Draft, data: Any) -> None:
    """Say of each sensor why it is left out."""
    for source, item in draft.items(data, ("sensor",)):
        kind = str(item.get("sensor_type")) if isinstance(item, Mapping) else repr(item)
        reason = SENSORS.get(kind)
        if reason is None:
            known = ", ".join(SENSORS)
            message = f"unknown sensor {kind!r}; known: {known}."
            draft.refuse((*source, "sensor_type"), message, did_you_mean(kind, SENSORS))
        else:
            draft.note(source, reason)


def _body_type(
    draft: Draft, section: str, item: Mapping[str, Any], source: Path, target: Path
) -> None:
    kind, where = item.get("body_type"), (*source, "body_type")
    if section == "background" and kind == "dynamic":
        draft.refuse(where, "a background object is static or kinematic; use rigid_object")
    elif kind is not None:
        draft.put((*target, "body_type"), kind, where)
    elif section == "background":
        draft.put((*target, "body_type"), "static", source)


def _shape(draft: Draft, data: Any, source: Path, target: Path) -> None:
    written = str(data.get("shape_type", "")) if isinstance(data, Mapping) else ""
    kind = written.removesuffix("Cfg")
    if kind not in SHAPES and draft.ours:
        draft.put(target, data, source)
        return
    if kind not in SHAPES:
        message = f"unknown shape_type {written!r}; known: {', '.join(SHAPES)}."
        draft.refuse((*source, "shape_type"), message, did_you_mean(kind, SHAPES))
        return
    draft.put((*target, "shape_type"), kind, (*source, "shape_type"))
    keys = {k: v for k, v in data.items() if k not in ("shape_type", "visual_material")}
    draft.carry(keys, source, target, SHAPES[kind])
    material = data.get("visual_material")
    if material is not None:
        where = (*source, "visual_material")
        draft.carry(material, where, (*target, "visual_material"), MATERIAL)
