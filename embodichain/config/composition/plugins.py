"""Imports the modules of packages that register tasks.

A package names its modules with the entry point group `embodichain.tasks`; this project's module
of tasks is always imported.
"""

from __future__ import annotations

import importlib
import importlib.metadata

from embodichain.lab.gym.utils.registration import REGISTERED_ENVS
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["load_task_packages", "require_registered"]

ENTRY_POINTS = "embodichain.tasks"
_OWN = "embodichain.tasks"


def load_task_packages() -> None:
    """Import every module that registers tasks; a second call changes nothing.

    Raises:
        Exception: Any exception of such a module, with a note that names its entry point.
    """
    importlib.import_module(_OWN)
    for entry in sorted(importlib.metadata.entry_points(group=ENTRY_POINTS)):
        try:
            importlib.import_module(entry.module)
        except Exception as error:
            error.add_note(f"while importing the entry point {entry.name!r} of {ENTRY_POINTS}")
            raise


def require_registered(env_id: str, *, allow_import: bool = True) -> str | None:
    """Return why an id cannot be made, or None if it can; may import packages of tasks.

    Args:
        env_id: An id, or ``package.module:id`` as in Gymnasium, which imports that module to
            register the id.
        allow_import: Whether such a module may be imported; False for configs read from a log.
    """
    module, _, name = env_id.rpartition(":")
    if module and not allow_import:
        return f"{module!r} would be imported, which is not done for this config"
    if module:
        try:
            importlib.import_module(module)
        except ImportError as error:
            return f"cannot import {module!r}: {error}"
    elif name not in REGISTERED_ENVS:
        load_task_packages()
    if name in REGISTERED_ENVS:
        return None
    known = listing(sorted(REGISTERED_ENVS), name)
    return f"no registered class {name!r}; there are: {known}.{did_you_mean(name, REGISTERED_ENVS)}"
