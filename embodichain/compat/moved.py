"""Old import paths of public modules, which answer for one release with a deprecation warning.

`install` appends a finder to Python's: it is asked only for modules that nothing else finds, so
that imports of modules that exist cost nothing. This module imports no other module of the package.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Final

__all__ = ["MOVED", "install"]

_TABLE: Final = {
    "config.composed": "config.composition.composed",
    "config.factory": "config.environments.factory",
    "config.gymnasium_envs": "config.environments.gymnasium_envs",
    "config.hydra_loader": "config.composition.hydra_loader",
    "config.validation": "config.checks.validation",
    "lab.gym.envs.context": "lab.gym.envs.managers.context",
    "lab.gym.envs.episodes": "lab.gym.envs.step.episodes",
    "lab.gym.envs.managers.aliases": "lab.gym.envs.managers.terms.aliases",
    "lab.gym.envs.managers.drawing": "lab.gym.envs.managers.random_managers",
    "lab.gym.envs.managers.per_name": "lab.gym.envs.managers.terms.per_name",
    "lab.gym.envs.managers.registry": "lab.gym.envs.managers.terms.registry",
    "lab.gym.envs.snapshot": "lab.gym.envs.restoring.snapshot",
    "lab.sim.contact_cfg": "lab.sim.configs.contact_cfg",
    "lab.sim.drive_cfg": "lab.sim.configs.drive_cfg",
    "lab.sim.physics_cfg": "lab.sim.configs.physics_cfg",
    "lab.sim.scene_cfg": "lab.sim.configs.scene_cfg",
    "lab.sim.self_collision_cfg": "lab.sim.configs.self_collision_cfg",
    "lab.sim.sensors.cfg": "lab.sim.sensors",
    "lab.sim.sensors.sensor_handles": "lab.sim.sensors",
    "lab.sim.solver_cfg": "lab.sim.configs.solver_cfg",
    "lab.sim.urdf_cfg": "lab.sim.configs.urdf_cfg",
    "learning.asymmetric": "learning.sb3.asymmetric",
    "learning.checkpoint": "learning.checkpoints.checkpoint",
    "learning.chunk_policy": "learning.cloning.chunk_policy",
    "learning.exported": "learning.policies.exported",
    "learning.exporting": "learning.policies.exporting",
    "learning.extractors": "learning.sb3.extractors",
    "learning.normalization": "learning.sb3.normalization",
    "learning.policy": "learning.policies.policy",
    "learning.rsl_rl_ppo": "learning.tensors.rsl_rl_ppo",
    "learning.skrl_ppo": "learning.tensors.skrl_ppo",
    "learning.symmetry": "learning.sb3.symmetry",
    "learning.train": "learning.training.train",
    "learning.vec_env": "learning.sb3.vec_env",
    "recording.api": "recording.read.api",
    "recording.augmentation": "recording.demos.augmentation",
    "recording.block": "recording.format.messages.block",
    "recording.collection": "recording.demos.collection",
    "recording.demonstrations": "recording.demos.demonstrations",
    "recording.export.lerobot": "recording.export.formats.lerobot",
    "recording.export.robomimic": "recording.export.episode_formats.robomimic",
    "recording.export.ros2": "recording.export.formats.ros2",
    "recording.export.rrd": "recording.export.formats.rrd",
    "recording.header": "recording.format.header",
    "recording.joining": "recording.shards.joining",
    "recording.log_diff": "recording.check.log_diff",
    "recording.options": "recording.format.options",
    "recording.recorder": "recording.write.recorder",
    "recording.summary": "recording.read.summary",
    "recording.verification": "recording.check.verification",
}
MOVED: Final[Mapping[str, str]] = {
    f"embodichain.{old}": f"embodichain.{new}" for old, new in _TABLE.items()
}
"""Old module -> the module that has its names now. The table leaves with the next release."""


class _Moved(Loader):
    """Creates a module that reads every name of the module that took its place."""

    def create_module(self, spec: ModuleSpec) -> None:
        """Return None, so that Python creates the module."""

    def exec_module(self, module: ModuleType) -> None:
        """Warn the importing line, and read names of the new module from now on."""
        old = module.__name__
        new = MOVED[old]
        warnings.warn(
            f"{old} is {new} now; the old path leaves with the next release",
            DeprecationWarning,
            stacklevel=2,
        )
        target = importlib.import_module(new)
        module.__doc__ = f"Moved to `{new}`."
        module.__getattr__ = lambda name: getattr(target, name)  # type: ignore[method-assign]
        module.__dir__ = lambda: dir(target)  # type: ignore[method-assign]


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return an alias for a module of the table."""
        if fullname not in MOVED:
            return None
        return ModuleSpec(fullname, _Moved())


def install() -> None:
    """Append the finder; once per process."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.append(_Finder())
