"""`PreparedScene`: files that were read and a model that was compiled while a config was checked.

It is passed from the check to the simulation that is built of the same config, so that nothing is
read or compiled twice.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.sim.drive_cfg import FileFirst

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import ArticulationCfg
    from embodichain.lab.sim.compiler.articulation import ParsedArticulation
    from embodichain.lab.sim.compiler.drives import DriveChange, PhysicsStep
    from embodichain.lab.sim.compiler.scene import CompiledScene, SceneParts

__all__ = ["PreparedScene"]


@dataclasses.dataclass(frozen=True)
class _Entry:
    """An articulation, its key path in the task, and all that its parsing depends on."""

    path: str
    parsed: ParsedArticulation
    step: PhysicsStep
    changes: Sequence[DriveChange]
    stamp: tuple[int, int]

    @property
    def key(self) -> Any:
        return _key([self.parsed.cfg, self.step, list(self.changes)])


class PreparedScene:
    """Parsed articulations and a compiled scene, each for the first simulation of equal config.

    What is taken is no longer kept. Configs are compared by value, files by their time and size.
    """

    def __init__(self) -> None:
        self._articulations: dict[str, _Entry] = {}
        self._scene: tuple[list[Any], Any, CompiledScene] | None = None

    def __deepcopy__(self, memo: Any) -> PreparedScene:
        return self

    def __reduce__(self) -> Any:
        return PreparedScene, ()

    # -- articulations -----------------------------------------------------------------------------

    def add_articulation(
        self,
        path: str,
        parsed: ParsedArticulation,
        step: PhysicsStep,
        changes: Sequence[DriveChange],
    ) -> None:
        """Store an articulation that has no mistakes.

        Args:
            path: Its key path in the task.
            parsed: The articulation.
            step: Time step and integrator that it was parsed for.
            changes: What events may draw for its drives and links.
        """
        entry = _Entry(path, parsed, step, changes, _stamp(parsed))
        self._articulations[parsed.uid] = entry

    def take_articulation(
        self, uid: str, cfg: ArticulationCfg, step: PhysicsStep, changes: Sequence[DriveChange]
    ) -> ParsedArticulation | None:
        """Return the articulation that would be parsed of these, or None."""
        entry = self._articulations.pop(uid, None)
        if entry is None or entry.stamp != _stamp(entry.parsed):
            return None
        if entry.key != _key([cfg, step, list(changes)]):
            return None
        return dataclasses.replace(entry.parsed, cfg=cfg)

    def settle_armature(self) -> dict[str, dict[str, float]]:
        """Take the armature that limited drives were given into the articulations' configs.

        Returns:
            Path of the articulation in the task -> joint -> its armature, kg m^2 or kg.
        """
        found: dict[str, dict[str, float]] = {}
        for uid, entry in self._articulations.items():
            parsed = entry.parsed
            raised = np.flatnonzero(parsed.added_armature).tolist()
            if raised:
                names = {parsed.joint_names[i]: float(parsed.armature[i]) for i in raised}
                settled = parsed.with_given_armature(names)
                self._articulations[uid] = dataclasses.replace(entry, parsed=settled)
                found[entry.path] = names
        return found

    # -- the scene ---------------------------------------------------------------------------------

    def add_scene(self, scene: CompiledScene, parts: SceneParts) -> None:
        """Store the scene that was compiled of these arguments of `compile_scene`."""
        self._scene = [parsed.spec for parsed in parts[1]], _scene_key(parts), scene

    def take_scene(self, parts: SceneParts) -> CompiledScene | None:
        """Return the scene that would be compiled of these arguments, or None."""
        found, self._scene = self._scene, None
        if found is None:
            return None
        specs, key, scene = found
        # Specs compare by identity: two that were read of one file are not the same.
        same = len(specs) == len(parts[1]) and all(
            spec is parsed.spec for spec, parsed in zip(specs, parts[1], strict=True)
        )
        return scene if same and key == _scene_key(parts) else None


def _scene_key(parts: SceneParts) -> Any:
    sim, _, *others = parts
    return _key([sim.physics_dt, sim.physics_config, sim.ground_plane, *others])


def _stamp(parsed: ParsedArticulation) -> tuple[int, int]:
    """Time and size of the file."""
    try:
        status = parsed.path.stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size


def _key(value: Any) -> Any:
    """A config as nested tuples; a `uid` is left out, because sections set it."""
    if isinstance(value, FileFirst):
        return "file first", float(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value) if field.name != "uid"]
        return type(value).__name__, *(_key(getattr(value, name)) for name in names)
    if isinstance(value, Mapping):
        return tuple((key, _key(item)) for key, item in value.items())
    if hasattr(value, "tolist"):  # numpy, torch
        value = value.tolist()
    return tuple(_key(item) for item in value) if isinstance(value, (list, tuple)) else value
