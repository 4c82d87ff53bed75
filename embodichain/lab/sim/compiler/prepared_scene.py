"""`PreparedScene`: files read and the model compiled while a config was checked.

The check passes it to the simulation built from the same config, so that nothing is read or
compiled twice.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.utils.fields.defaults import is_given

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import ArticulationCfg
    from embodichain.lab.sim.compiler.compile_scene import CompiledScene, SceneParts
    from embodichain.lab.sim.compiler.names import Known
    from embodichain.lab.sim.compiler.robot.drives.pd_drives import DriveChange, PhysicsStep
    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
    from embodichain.lab.sim.compiler.scene.world import World
    from embodichain.lab.sim.configs.scene_cfg import SceneCfg

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

    Taking an entry removes it. Configs are compared by value, files by their time and size.

    Attributes:
        known: The declared entities, by uid, of a scene that was checked; else None.
    """

    def __init__(self) -> None:
        self._articulations: dict[str, _Entry] = {}
        self._scene: tuple[list[Any], Any, CompiledScene] | None = None
        self._world: tuple[Any, World] | None = None
        self.known: Known | None = None

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
        """Store an articulation without mistakes.

        Args:
            path: Its key path in the task.
            parsed: The articulation.
            step: Time step and integrator it was parsed for.
            changes: Values that events may draw for its drives and links.
        """
        entry = _Entry(path, parsed, step, changes, _stamp(parsed))
        self._articulations[parsed.uid] = entry

    def take_articulation(
        self, uid: str, cfg: ArticulationCfg, step: PhysicsStep, changes: Sequence[DriveChange]
    ) -> ParsedArticulation | None:
        """Return the stored articulation that was parsed from equal arguments, or None."""
        entry = self._articulations.pop(uid, None)
        if entry is None or entry.stamp != _stamp(entry.parsed):
            return None
        if entry.key != _key([cfg, step, list(changes)]):
            return None
        return dataclasses.replace(entry.parsed, cfg=cfg)

    def settle_armature(self) -> dict[str, dict[str, float]]:
        """Write the armature that was added for limited drives into the articulations' configs.

        Returns:
            Key path of the articulation in the task -> joint -> armature, kg m^2 or kg.
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

    @property
    def scene(self) -> CompiledScene | None:
        """The stored scene, if it was not taken."""
        return None if self._scene is None else self._scene[2]

    def add_scene(self, scene: CompiledScene, parts: SceneParts) -> None:
        """Store the scene that `compile_scene` made from these arguments."""
        self._scene = _specs(parts), _scene_key(parts), scene

    def take_scene(self, parts: SceneParts) -> CompiledScene | None:
        """Return the stored scene that was compiled from equal arguments, or None."""
        found, self._scene = self._scene, None
        if found is None:
            return None
        specs, key, scene = found
        # Specs compare by identity: two read from one file are not equal.
        here = _specs(parts)
        same = len(specs) == len(here) and all(map(operator.is_, specs, here))
        return scene if same and key == _scene_key(parts) else None

    def add_world(self, cfg: SceneCfg, world: World) -> None:
        """Store the world that was read from a scene's file."""
        self._world = (cfg.fpath, cfg.keyframe, _stamp(world)), world

    def take_world(self, cfg: SceneCfg) -> World | None:
        """Return the stored world of the same file and keyframe, or None."""
        found, self._world = self._world, None
        if found is None or found[0] != (cfg.fpath, cfg.keyframe, _stamp(found[1])):
            return None
        return found[1]


def _specs(parts: SceneParts) -> list[Any]:
    return [file.spec for file in (*parts[1], parts[5]) if file is not None]


def _scene_key(parts: SceneParts) -> Any:
    sim, _, *others, _ = parts
    own = sim.physics_dt, sim.physics_config, sim.has_ground, sim.scene, sim.views
    return _key([*own, *others])


def _stamp(parsed: ParsedArticulation | World) -> tuple[int, int]:
    """Time and size of the file."""
    try:
        status = parsed.path.stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size


def _key(value: Any) -> Any:
    """A config as nested tuples, without `uid`, which the sections of a task set."""
    if not is_given(value):
        return "default", str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value) if field.name != "uid"]
        return type(value).__name__, *(_key(getattr(value, name)) for name in names)
    if isinstance(value, Mapping):
        return tuple((key, _key(item)) for key, item in value.items())
    if hasattr(value, "tolist"):  # numpy, torch
        value = value.tolist()
    return tuple(_key(item) for item in value) if isinstance(value, (list, tuple)) else value
