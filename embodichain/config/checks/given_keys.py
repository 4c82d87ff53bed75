"""`check_given`: keys of a config file that change nothing, or that another key overrides.

Data classes do not say whether a value was given or is the default: this reads it from the tree.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    AttachedFileCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
)
from embodichain.lab.sim.sensors.camera_cfg import (
    HAS_ITS_OWN,
    SAID_BY_EYE,
    CameraCfg,
    ExtrinsicsCfg,
)
from embodichain.utils.errors import Problem
from embodichain.utils.fields.no_effect import config_nodes, no_effect_fields

__all__ = ["check_given"]

_REFUSED = ("restitution", "static_friction")
"""Attributes that MuJoCo has no physics for: a mistake, not only without effect."""
_OF_FILE = ("mass", "density", "linear_damping", "angular_damping")
"""Attributes that an articulation takes from its file."""


def check_given(root: Any, tree: Mapping[str, Any]) -> tuple[list[Problem], list[Problem]]:
    """Return every given key that is wrong beside others, and every one that changes nothing.

    Args:
        root: A config as data classes.
        tree: The plain values it was read from.

    Returns:
        Mistakes, and notes; paths are those of the tree.
    """
    problems: list[Problem] = []
    notes: list[Problem] = []
    for path, cfg, given in config_nodes(root, tree):
        problems += [p.below(path) for p in _mistakes(cfg, given)]
        notes += [p.below(path) for p in _ignored(cfg, given)]
    return problems, notes


def _ignored(cfg: Any, given: Mapping[str, Any]) -> Iterator[Problem]:
    """Given keys of one config that change nothing."""
    is_attributes = isinstance(cfg, RigidBodyAttributesCfg)
    for name, mark in no_effect_fields(cfg).items():
        if given.get(name) is not None and not (is_attributes and name in _REFUSED):
            yield Problem(name, mark.message)
    if is_attributes and given.get("density") is not None and cfg.mass > 0:
        mass = "1 kg unless given" if given.get("mass") is None else f"{cfg.mass:g} kg"
        yield Problem("density", f"has no effect: the mass is {mass}; mass: 0 uses the density")
    if isinstance(cfg, ArticulationCfg | AttachedFileCfg):
        attrs = given.get("attrs") or {}
        for name in _OF_FILE:
            if attrs.get(name) is not None:
                yield Problem(f"attrs.{name}", "has no effect: links keep the value of their file")


def _mistakes(cfg: Any, given: Mapping[str, Any]) -> Iterator[Problem]:
    """Given keys of one config that are impossible, or that another key sets too."""
    from embodichain.lab.sim.compiler.scene.rigid_objects import (  # imports MuJoCo
        HAS_SHAPES,
        OF_EACH_SHAPE,
    )

    if isinstance(cfg, RigidBodyAttributesCfg):
        yield from (_refusal(name, given[name]) for name in _REFUSED if given.get(name))
    if isinstance(cfg, RigidObjectCfg) and cfg.any_of:
        yield from (Problem(name, HAS_SHAPES) for name in OF_EACH_SHAPE if name in given)
    if isinstance(cfg, CameraCfg) and cfg.camera is not None and given.get("extrinsics"):
        yield Problem("extrinsics", HAS_ITS_OWN.format(cfg.camera))
    if isinstance(cfg, ExtrinsicsCfg) and (cfg.eye is not None or cfg.target is not None):
        yield from (Problem(name, SAID_BY_EYE) for name in ("pos", "quat") if name in given)


def _refusal(name: str, value: float) -> Problem:
    """The problem of a coefficient that MuJoCo does not have, and what to write instead."""
    from embodichain.lab.sim.compiler.geoms.contact_parameters import (  # imports MuJoCo
        LEAST_RESTITUTION,
        bouncing_solref,
    )

    if name == "static_friction":
        message = "MuJoCo has one sliding coefficient: give dynamic_friction, and leave this out"
        return Problem(name, f"{message}; got {value:g}")
    message = f"MuJoCo has no restitution coefficient: must be 0, got {value:g}"
    if not LEAST_RESTITUTION < value < 1:
        return Problem(name, message)
    time, ratio = bouncing_solref(value)
    instead = f"`contact: {{solref: [{time:.4g}, {ratio:.4g}]}}` bounces back with about this share"
    return Problem(name, message, f"{instead} of the speed (of a robot: `contact: {{LINK: ...}}`)")
