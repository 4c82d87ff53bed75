"""Ids of YAML tasks in Gymnasium's registry: ``embodichain/NAME-v0``. `gymnasium_envs` makes them.

Gymnasium has had no plug-ins since 1.0: an id exists once the package that registers it is
imported, or is named in the id (``embodichain:embodichain/reach-v0``). So `import embodichain`
registers, before or after `import gymnasium`.
"""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:  # importlib.abc takes 30 ms, and `import embodichain` without it 10
    from collections.abc import Sequence
    from importlib.abc import Loader
    from importlib.machinery import ModuleSpec
    from types import ModuleType

__all__ = ["register_task_ids", "register_with_gymnasium", "task_id", "task_of_id"]

_ID = re.compile(r"embodichain/([\w.-]+)-v0")
_ENVS = "embodichain.config.gymnasium_envs"


def task_id(name: str) -> str:
    """Return the id of a YAML task: ``embodichain/reach-v0`` of ``reach``."""
    return f"embodichain/{name}-v0"


def task_of_id(env_id: str) -> str | None:
    """Return the name of the YAML task that an id stands for, or None if it is no such id."""
    match = _ID.fullmatch(env_id)
    return match[1] if match else None


def register_task_ids() -> None:
    """Register every YAML task that has no id yet: of this package, of plug-ins, of ``./conf``."""
    from gymnasium.envs.registration import register, registry

    from embodichain.config.task_files import task_names  # metadata of packages: not before

    for name in task_names():
        # A file whose name Gymnasium's grammar does not allow is a task without an id.
        if task_of_id(task_id(name)) and task_id(name) not in registry:
            register(
                task_id(name),
                entry_point=f"{_ENVS}:TaskEnv",
                vector_entry_point=f"{_ENVS}:make_task_vec",
                kwargs={"task": name},
            )


def register_with_gymnasium() -> None:
    """Register every YAML task now if Gymnasium is imported, otherwise as soon as it is.

    Gymnasium takes longer to import than the whole command line: it is not imported for this.
    """
    if "gymnasium" in sys.modules:
        register_task_ids()
    elif not any(isinstance(finder, _OnceImported) for finder in sys.meta_path):
        sys.meta_path.insert(0, _OnceImported())


class _OnceImported:
    """A finder of `sys.meta_path` that finds Gymnasium as the others do, with another loader."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how Gymnasium is imported; None for every other module."""
        if name != "gymnasium":
            return None
        for finder in sys.meta_path:
            spec = None if finder is self else finder.find_spec(name, path, target)
            if spec is not None and spec.loader is not None:
                spec.loader = cast("Loader", _ThenRegister(spec.loader, self))
                return spec
        return None


class _ThenRegister:
    """Loads Gymnasium with its own loader, which the module keeps, and registers the tasks."""

    def __init__(self, loader: Loader, finder: _OnceImported) -> None:
        self._loader = loader
        self._finder = finder

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Return what its own loader creates."""
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Execute the module; when that has worked, the finder has done its work."""
        module.__loader__ = self._loader
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        if self._finder in sys.meta_path:
            sys.meta_path.remove(self._finder)
        register_task_ids()
