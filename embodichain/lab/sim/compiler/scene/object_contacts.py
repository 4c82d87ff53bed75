"""The contact parameters of a rigid object: its friction, and its `contact`."""

from __future__ import annotations

import dataclasses

from embodichain.lab.sim.cfg import RigidObjectCfg
from embodichain.lab.sim.compiler.geoms.contact_parameters import (
    ContactParameters,
    check_fixed_contact,
    fixed_contact,
)
from embodichain.lab.sim.configs.contact_cfg import ContactCfg
from embodichain.utils.errors import Problem
from embodichain.utils.fields.defaults import is_given

__all__ = ["check_object_contact", "object_contact"]


def check_object_contact(cfg: RigidObjectCfg) -> list[Problem]:
    """Return every mistake in the contact parameters of an object, with paths below it."""
    contact = cfg.contact
    if contact is None:
        return []
    problems: list[Problem] = []
    if cfg.body_type == "static":
        mistakes = check_fixed_contact(_given_contact(cfg))
        problems += [mistake.below("contact") for mistake in mistakes]
    if contact.friction is not None and is_given(cfg.attrs.dynamic_friction):
        message = "attrs.dynamic_friction is given as well: leave one of them out"
        problems.append(Problem("contact.friction", message))
    for name, variant in cfg.any_of.items():
        if contact.friction is not None and variant.dynamic_friction is not None:
            message = "contact.friction of the object is given as well: leave one of them out"
            problems.append(Problem(f"any_of.{name}.dynamic_friction", message))
    return problems


def _given_contact(cfg: RigidObjectCfg) -> ContactCfg:
    """The object's contact parameters, with the friction of `attrs` if that is given."""
    contact = cfg.contact or ContactCfg()
    friction = cfg.attrs.dynamic_friction
    if contact.friction is None and is_given(friction):
        return dataclasses.replace(contact, friction=float(friction))
    return contact


def object_contact(cfg: RigidObjectCfg) -> ContactParameters:
    """Return the contact parameters of an object; one that does not move lets others decide."""
    contact = _given_contact(cfg)
    default = ContactParameters(friction=(float(cfg.attrs.dynamic_friction),))
    if cfg.body_type == "static":
        return fixed_contact(contact).over(default)
    return ContactParameters.of_config(contact).over(default)
