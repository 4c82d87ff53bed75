"""`NamedJoints`: names and indices of an articulation's joints, links and parts."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco

from embodichain.lab.sim.objects._arrays import names_matching
from embodichain.lab.sim.objects.entity import BatchEntity
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import ArticulationCfg
    from embodichain.lab.sim.compiler import ParsedArticulation
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = ["NamedJoints"]


class NamedJoints(BatchEntity):
    """An entity with named joints and links, known before the scene is compiled."""

    def __init__(
        self, cfg: ArticulationCfg, parsed: ParsedArticulation, sim: SimulationManager
    ) -> None:
        super().__init__(cfg, parsed.uid, sim)
        self.parsed = parsed

    def destroy(self) -> None:
        """Drop the handle's hold on the engine, and the file's own model; its names stay."""
        super().destroy()
        empty = mujoco.MjSpec()
        self.parsed = dataclasses.replace(self.parsed, spec=empty, model=empty.compile())

    @property
    def dof(self) -> int:
        """D."""
        return len(self.parsed.joint_names)

    @property
    def joint_names(self) -> list[str]:
        """Names of the D joints, in qpos order."""
        return list(self.parsed.joint_names)

    @property
    def all_joint_names(self) -> list[str]:
        """Same as `joint_names`: fixed joints are gone after parsing."""
        return list(self.parsed.joint_names)

    @property
    def mimic_ids(self) -> list[int]:
        """Joints that follow another one."""
        return list(self.parsed.mimic_ids)

    @property
    def mimic_parents(self) -> list[int]:
        """The joint each of `mimic_ids` follows."""
        return list(self.parsed.mimic_parents)

    @property
    def mimic_multipliers(self) -> list[float]:
        """Slope of each mimic joint."""
        return list(self.parsed.mimic_multipliers)

    @property
    def mimic_offsets(self) -> list[float]:
        """Offset of each mimic joint, rad or m."""
        return list(self.parsed.mimic_offsets)

    @property
    def active_joint_ids(self) -> list[int]:
        """Joints that do not mimic another one."""
        mimic = set(self.parsed.mimic_ids)
        return [i for i in range(self.dof) if i not in mimic]

    @property
    def active_joint_names(self) -> list[str]:
        """Names of `active_joint_ids`."""
        return [self.parsed.joint_names[i] for i in self.active_joint_ids]

    @property
    def active_dof(self) -> int:
        """Number of `active_joint_ids`."""
        return len(self.active_joint_ids)

    @property
    def link_names(self) -> list[str]:
        """Names of the L links, parents before children."""
        return list(self.parsed.link_names)

    @property
    def root_link_name(self) -> str:
        """Name of the root link."""
        return self.parsed.root_link_name

    def find_joints(self, patterns: str | Sequence[str]) -> list[int]:
        """Indices of joints whose names a regex matches in full, in joint order.

        Raises:
            ValueError: If a pattern matches nothing; lists the joints.
        """
        return names_matching(patterns, self.parsed.joint_names, f"joint of {self.uid}")

    def find_links(self, patterns: str | Sequence[str]) -> list[int]:
        """Indices of links whose names a regex matches in full, in link order."""
        return names_matching(patterns, self.parsed.link_names, f"link of {self.uid}")

    def get_joint_ids(self, name: str | None = None, remove_mimic: bool = False) -> list[int]:
        """Joint indices of a control part, or of the whole articulation.

        Raises:
            ValueError: If there is no such part; lists the parts.
        """
        if name is None:
            ids = list(range(self.dof))
        else:
            parts = self.parsed.control_parts
            if name not in parts:
                raise ValueError(
                    f"{self.uid} has no control part {name!r}; there are: "
                    f"{', '.join(parts) or 'none'}.{did_you_mean(name, parts)}"
                )
            ids = list(parts[name])
        return [i for i in ids if i not in self.parsed.mimic_ids] if remove_mimic else ids
