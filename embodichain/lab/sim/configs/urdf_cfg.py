"""`URDFCfg`: one robot assembled from several URDF files, such as arm and hand. Pure data.

Names, order and parents of the components are those of EmbodiChain 0.2.1. The compiler assembles
the files (`compiler.robot_assembly`); nothing is written to disk.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from embodichain.utils.configclass import configclass
from embodichain.utils.fields.no_effect import NoEffect

__all__ = ["COMPONENTS", "URDFCfg", "URDFComponentCfg"]

COMPONENTS: dict[str, str] = {
    "chassis": "",
    "legs": "",
    "torso": "",
    "head": "",
    "left_arm": "left_",
    "right_arm": "right_",
    "left_hand": "left_",
    "right_hand": "right_",
    "arm": "",
    "hand": "",
}
"""Component -> prefix of its names, in order of assembly."""
_WRITTEN = NoEffect("robots are assembled when they are read: nothing is written")
Case = Literal["upper", "lower", "none", "original"]


@configclass
class URDFComponentCfg:
    """One file of an assembled robot."""

    component_type: str = ""
    """chassis, legs, torso, head, left_arm, right_arm, left_hand, right_hand, arm or hand."""
    urdf_path: str = ""
    """A file, found by `embodichain.data.get_data_path`."""
    transform: Any = None
    """4x4 pose of its first link in the parent link; None is the identity."""


@configclass
class URDFCfg:
    """Components that are fixed on each other.

    A hand is fixed on the last link of its arm; an arm on the last link of the torso, else on the
    first link of the chassis, else on the base. A single component keeps its file's names.
    """

    components: list[URDFComponentCfg] | dict[str, URDFComponentCfg] = []
    """A list, or a map by `component_type`."""
    sensors: Any = None
    """Not available: declare sensors beside the robot."""
    fpath: Annotated[str | None, _WRITTEN] = None
    """No effect: nothing is written."""
    fname: Annotated[str | None, _WRITTEN] = None
    """No effect."""
    fpath_prefix: Annotated[str | None, _WRITTEN] = None
    """No effect."""
    use_signature_check: Annotated[bool, _WRITTEN] = True
    """No effect: nothing is cached."""
    base_link_name: str = "base_link"
    """Name of the massless root link."""
    component_prefix: Any = None
    """(component, prefix) pairs or a map; other components have their default prefix."""
    name_case: dict[str, Case] = dataclasses.field(
        default_factory=lambda: {"joint": "upper", "link": "lower"}
    )
    """Case of ``joint`` and ``link`` names; ``none`` and ``original`` keep the files'."""

    def __post_init__(self) -> None:
        """Convert components that are plain maps."""
        components = self.components
        if isinstance(components, Mapping):
            self.components = [_component(part, kind) for kind, part in components.items()]
        else:
            self.components = [_component(part) for part in components or ()]

    def add_component(self, component_type: str, urdf_path: str, transform: Any = None) -> URDFCfg:
        """Add a component, or replace the one of the same type; returns the config."""
        rest = [c for c in self.parts() if c.component_type != component_type]
        self.components = [*rest, URDFComponentCfg(component_type, urdf_path, transform)]
        return self

    def set_urdf(self, urdf_path: str) -> URDFCfg:
        """Replace all components by one file; returns the config."""
        self.components = [URDFComponentCfg("", urdf_path)]
        return self

    def parts(self) -> Sequence[URDFComponentCfg]:
        """The components as a list."""
        components = self.components
        if isinstance(components, dict):
            return list(components.values())
        return components

    def stem(self) -> str:
        """The joined stems of the files: the robot's name if it has no uid."""
        names = (part.urdf_path.replace("\\", "/").rsplit("/", 1)[-1] for part in self.parts())
        return "_".join(name.rsplit(".", 1)[0] for name in names)

    def prefixes(self) -> dict[str, str]:
        """Component -> prefix, in order of assembly."""
        prefixes = dict(self.component_prefix or {})
        return {name: prefixes.get(name, default) or "" for name, default in COMPONENTS.items()}


def _component(part: Any, kind: str = "") -> URDFComponentCfg:
    """Return a component's config, of a plain map too; a kind replaces its own."""
    cfg: URDFComponentCfg = URDFComponentCfg(**part) if isinstance(part, Mapping) else part
    if kind:
        cfg = dataclasses.replace(cfg, component_type=kind)
    return cfg
