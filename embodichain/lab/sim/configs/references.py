"""References to entities in configs, and their parts: `LinksCfg`, `JointsCfg`; and their names."""

from __future__ import annotations

import dataclasses
from typing import Any

from pydantic import AliasChoices, Field

from embodichain.utils.configclass import configclass

__all__ = ["OF", "REFERENCE_WORDS", "JointsCfg", "LinksCfg"]

REFERENCE_WORDS = {"entity_cfg": "of", "source_entity_cfg": "from", "target_entity_cfg": "to"}
"""EmbodiChain's names of references to entities -> the words that configs write for them."""

FRAME_KEYS = ("link_names", "site_names", "geom_names", "link", "site", "geom")
"""Keys of a reference that pick links, sites or geoms."""

OF: Any = Field(validation_alias=AliasChoices("of", "entity_cfg"))
"""For the annotation of a field `of`: it is read from `entity_cfg` as well."""


@configclass
class LinksCfg:
    """An entity and, optionally, some of its links, or of its sites, or of its geoms.

    They are in the entity's order, or with `preserve_order` in the order of the patterns.
    """

    uid: str = ""
    link_names: str | list[str] | None = None
    """Names or regexes, matched in full."""
    preserve_order: bool = False
    site_names: str | list[str] | None = dataclasses.field(default=None, kw_only=True)
    """Sites of the file instead."""
    geom_names: str | list[str] | None = dataclasses.field(default=None, kw_only=True)
    """Geoms of the file that have a name instead."""
    link: str | None = dataclasses.field(default=None, kw_only=True)
    """One link: its name, or a regex that only it matches."""
    site: str | None = dataclasses.field(default=None, kw_only=True)
    """One site, likewise."""
    geom: str | None = dataclasses.field(default=None, kw_only=True)
    """One geom, likewise."""

    def frame_keys(self) -> list[str]:
        """Return its keys that pick links, sites or geoms."""
        return [key for key in FRAME_KEYS if getattr(self, key) is not None]


@configclass
class JointsCfg(LinksCfg):
    """An entity and, optionally, some of its joints (links, sites and geoms are refused)."""

    joint_names: str | list[str] | None = None
    """Names or regexes, matched in full; without it, all joints that follow no other joint."""
