"""What the processes that fork commands share: the modules that they have imported, and streams.

`commands` and `forks` start such processes. A command tells at its end what else it has imported,
and the process imports that too, so that the next command need not.
"""

from __future__ import annotations

import gc
import importlib
import io
import os
import sys
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path

import embodichain

__all__ = ["import_again", "import_first", "imported_since", "open_stdout_and_stderr"]

_FIRST = (
    "PIL.Image",
    "embodichain.cli.jobs.work.collect_job",
    "embodichain.cli.jobs.work.evaluate_job",
    "embodichain.cli.jobs.work.run_job",
    "embodichain.cli.jobs.work.train_job",
    "embodichain.cli.sweeps.sweeping",
    "embodichain.config.environments.factory",
    "embodichain.learning.training.train",
    "embodichain.tasks",
    "hydra",
    "matplotlib.pyplot",
    "mcap",
    "mujoco",
    "scipy.stats",
    "stable_baselines3",
    "torch._dynamo",
)
_ALONE = ("IPython", "OpenGL", "__", "mujoco.", "mujoco_warp", "ray", "rerun", "warp")
"""Modules that start something, or read the environment, where they are imported."""
_PLACES = (
    sys.prefix,
    sys.base_prefix,
    *(str(Path(folder).resolve().parent) for folder in embodichain.__path__),
)
"""Folders of modules that every command finds under the same name."""


def import_first() -> None:
    """Import what most commands need.

    Raises:
        ImportError: A module has moved: it would be imported by each command anew.
    """
    for name in _FIRST:
        importlib.import_module(name)
    _spare_the_collector()


def imported_since(before: Collection[str]) -> list[str]:
    """Return the modules that were imported since, and that a fork may have from the beginning.

    Args:
        before: Names of the modules that there were.
    """
    return [
        name
        for name, module in list(sys.modules.items())
        if name not in before
        and not name.startswith(_ALONE)
        and (getattr(module, "__file__", None) or "").startswith(_PLACES)
    ]


def import_again(names: Iterable[str]) -> None:
    """Import what a fork has imported, so that no other has to."""
    missing = [name for name in names if name not in sys.modules]
    if not missing:
        return
    for name in missing:
        with suppress(Exception):  # an extra that is not installed, or an import with a condition
            importlib.import_module(name)
    _spare_the_collector()


def _spare_the_collector() -> None:
    """Take what there is out of the garbage collector, for all forks.

    As it ends, each would look through a million objects otherwise, and copy their pages: 1.3 s of
    CPU time, more than most commands take.
    """
    gc.collect()
    gc.freeze()


def open_stdout_and_stderr() -> None:
    """Make the streams anew of the descriptors 1 and 2, as an interpreter does that starts."""
    sys.stdout = io.TextIOWrapper(
        io.FileIO(1, "w", closefd=False), encoding="utf-8", line_buffering=os.isatty(1)
    )
    sys.stderr = io.TextIOWrapper(
        io.FileIO(2, "w", closefd=False),
        encoding="utf-8",
        errors="backslashreplace",
        line_buffering=True,
    )
