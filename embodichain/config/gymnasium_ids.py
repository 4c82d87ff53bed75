"""Names of YAML tasks, and their ids in Gymnasium's registry: ``embodichain/NAME-v0``.

Gymnasium has had no plug-ins since 1.0: an id exists once the package that registers it is
imported, or is named in the id (``embodichain:embodichain/reach-v0``). So `import embodichain`
registers them, before or after `import gymnasium`. `gymnasium_envs` builds the environments.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

__all__ = [
    "CONFIG_MODULE",
    "ENTRY_POINTS",
    "LOCAL",
    "register_task_ids",
    "register_with_gymnasium",
    "task_id",
    "task_names",
    "task_of_id",
]

CONFIG_MODULE = "embodichain.conf"
"""The YAML tree of this package."""
ENTRY_POINTS = "embodichain.conf"
"""The entry point group with which packages name their YAML trees."""
LOCAL = "conf"
"""The user's YAML tree, in the working directory."""
_ID = re.compile(r"embodichain/([\w.-]+)-v0")
_ENVS = "embodichain.config.environments.gymnasium_envs"


def task_id(name: str) -> str:
    """Return the id of a YAML task: ``embodichain/reach-v0`` of ``reach``."""
    return f"embodichain/{name}-v0"


def task_of_id(env_id: str) -> str | None:
    """Return the name of the YAML task with this id, or None for another kind of id."""
    match = _ID.fullmatch(env_id)
    return match[1] if match else None


def task_names() -> list[str]:
    """Return the sorted names of the tasks in this package, in plug-ins and in ``./conf``.

    Folders are listed; no YAML is read and no package imported.
    """
    return sorted({file.stem for folder in _folders() for file in (folder / "task").glob("*.yaml")})


def register_task_ids() -> None:
    """Register every YAML task of this package, plug-ins and ``./conf`` that has no id yet."""
    from gymnasium.envs.registration import register, registry

    for name in task_names():
        # A task has no id if Gymnasium's grammar does not allow the name of its file.
        if task_of_id(task_id(name)) and task_id(name) not in registry:
            register(
                task_id(name),
                entry_point=f"{_ENVS}:TaskEnv",
                vector_entry_point=f"{_ENVS}:make_task_vec",
                kwargs={"task": name},
            )


def register_with_gymnasium() -> None:
    """Register every YAML task now if Gymnasium is imported, otherwise as soon as it is.

    Gymnasium is not imported for this: that takes longer than the whole command line.
    """
    if "gymnasium" in sys.modules:
        register_task_ids()
    elif not any(isinstance(finder, _OnceImported) for finder in sys.meta_path):
        sys.meta_path.insert(0, _OnceImported())


class _OnceImported:
    """A finder of `sys.meta_path` that registers the tasks after Gymnasium is imported.

    It removes itself once Gymnasium is imported.
    """

    def __init__(self) -> None:
        self._searching = False

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of Gymnasium; None for every other module."""
        if name != "gymnasium" or self._searching:
            return None
        self._searching = True
        try:
            spec = find_spec(name)
        finally:
            self._searching = False
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                execute(module)
                if self in sys.meta_path:
                    sys.meta_path.remove(self)
                register_task_ids()

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def _folders() -> Iterator[Path]:
    from importlib.metadata import entry_points  # takes 10 ms

    yield Path(LOCAL)
    for module in (CONFIG_MODULE, *(entry.value for entry in entry_points(group=ENTRY_POINTS))):
        package, *rest = module.split(".")
        spec = find_spec(package)  # of a top-level name: nothing is imported
        for place in (spec and spec.submodule_search_locations) or ():
            yield Path(place, *rest)
