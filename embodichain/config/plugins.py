"""Packages that bring tasks: their modules are imported, so that what they register exists.

A package names its modules with the entry point group `embodichain.tasks`; this project's own
module of tasks is always among them.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from functools import partial

from embodichain.lab.gym.utils.registration import REGISTERED_ENVS
from embodichain.utils.suggest import did_you_mean

__all__ = ["load_task_packages", "require_registered"]

ENTRY_POINTS = "embodichain.tasks"
_OWN = "embodichain.tasks"


def load_task_packages() -> None:
    """Import every module that registers tasks; a second time changes nothing.

    Raises:
        Exception: Whatever such a module raises, with a note that names its entry point.
    """
    importlib.import_module(_OWN)
    for entry in sorted(importlib.metadata.entry_points(group=ENTRY_POINTS)):
        try:
            importlib.import_module(entry.module)
        except Exception as error:
            error.add_note(f"while importing the entry point {entry.name!r} of {ENTRY_POINTS}")
            raise


def require_registered(env_id: str) -> str | None:
    """Return why an id cannot be made, or None if it can; imports packages of tasks to find out."""
    if env_id not in REGISTERED_ENVS:
        load_task_packages()
    classes = [uid for uid, spec in REGISTERED_ENVS.items() if not isinstance(spec.cls, partial)]
    if env_id in classes:  # the others are YAML tasks, which a task cannot be made of
        return None
    known = ", ".join(sorted(classes)) or "none"
    return f"no registered class {env_id!r}; there are: {known}.{did_you_mean(env_id, classes)}"
