"""`URDFCfg`: one robot of several URDF files, arm and hand for example. Pure data.

Names, order of the components, and which is fixed on which are EmbodiChain 0.2.1's; the compiler
puts the files together (`compiler.robot_assembly`) and nothing is written to disk.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from embodichain.utils.configclass import configclass

__all__ = ["COMPONENTS", "URDFCfg", "URDFComponentCfg"]

COMPONENTS: dict[str, str] = {
    **dict.fromkeys(("chassis", "legs", "torso", "head"), ""),
    **{"left_arm": "left_", "right_arm": "right_", "left_hand": "left_", "right_hand": "right_"},
    **{"arm": "", "hand": ""},
}
"""Component -> prefix of its names, in the order in which they are put together."""
Case = Literal["upper", "lower", "none", "original"]


@configclass
class URDFComponentCfg:
    """One file of an assembled robot."""

    component_type: str = ""
    """chassis, legs, torso, head, left_arm, right_arm, left_hand, right_hand, arm or hand."""
    urdf_path: str = ""
    """What `embodichain.data.get_data_path` finds."""
    transform: Any = None
    """4x4 pose of its first link in the link that carries it; None is the identity."""


@configclass
class URDFCfg:
    """Components that are fixed on each other.

    A hand is fixed on the last link of its arm, an arm on the last link of the torso, else on the
    first of the chassis, else on the base. One component alone is its file, with the file's names.
    """

    components: list[URDFComponentCfg] | dict[str, URDFComponentCfg] = []
    """A list, or a map by `component_type`."""
    sensors: Any = None
    """Not available: declare sensors beside the robot."""
    fpath: str | None = None
    """No effect: nothing is written."""
    fname: str | None = None
    """No effect."""
    fpath_prefix: str | None = None
    """No effect."""
    use_signature_check: bool = True
    """No effect: nothing is cached."""
    base_link_name: str = "base_link"
    """The link that carries the whole; it has no mass."""
    component_prefix: Any = None
    """(component, prefix) pairs or a map; what is missing has its usual prefix."""
    name_case: dict[str, Case] = dataclasses.field(
        default_factory=lambda: {"joint": "upper", "link": "lower"}
    )
    """How ``joint`` and ``link`` names are spelled; ``none`` and ``original`` keep the files'."""

    def __post_init__(self) -> None:
        """Take components as plain maps, too."""
        given = self.components
        entries: list[tuple[str, Any]]
        if isinstance(given, Mapping):
            entries = list(given.items())
        else:
            entries = [("", component) for component in given or ()]
        self.components = [_component(component, kind) for kind, component in entries]

    def add_component(self, component_type: str, urdf_path: str, transform: Any = None) -> URDFCfg:
        """Add a component, or replace that of its type; returns the config."""
        rest = [c for c in self.parts() if c.component_type != component_type]
        self.components = [*rest, URDFComponentCfg(component_type, urdf_path, transform)]
        return self

    def set_urdf(self, urdf_path: str) -> URDFCfg:
        """Make the robot one file; returns the config."""
        self.components = [URDFComponentCfg("", urdf_path)]
        return self

    def parts(self) -> Sequence[URDFComponentCfg]:
        """The components as a list."""
        given = self.components
        return list(given.values()) if isinstance(given, dict) else given

    def stem(self) -> str:
        """The stems of the files, joined: what the robot is called without a uid."""
        names = (part.urdf_path.replace("\\", "/").rsplit("/", 1)[-1] for part in self.parts())
        return "_".join(name.rsplit(".", 1)[0] for name in names)

    def prefixes(self) -> dict[str, str]:
        """Component -> prefix, in the order in which they are put together."""
        given = dict(self.component_prefix or {})
        return {name: given.get(name, usual) or "" for name, usual in COMPONENTS.items()}


def _component(given: Any, kind: str) -> URDFComponentCfg:
    part: URDFComponentCfg = URDFComponentCfg(**given) if isinstance(given, Mapping) else given
    return dataclasses.replace(part, component_type=kind) if kind else part
