"""A run's own folder: claimed once, never shared, holding what it takes to do the run again.

`OUTPUT/DATE/TIME_TASK` is made by an exclusive mkdir; `OUTPUT/latest` is a link to the newest. What
a verb writes into it besides (log, summary, checkpoints) is the verb's.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from embodichain.config.frozen import dump_yaml
from embodichain.config.resolved import Resolved
from embodichain.utils.atomic import write_text
from embodichain.utils.errors import ConfigError
from embodichain.utils.versions import installed_versions

__all__ = ["adopt", "claim", "find_run", "write_record"]

LATEST = "latest"
_MOST_SUFFIXES = 10_000


def claim(output_root: str | Path, task: str, now: datetime | None = None) -> Path:
    """Make a new folder for a run, and let ``latest`` point to it.

    Args:
        output_root: Made when missing.
        task: Part of the name.
        now: Its date and time; None is the present, local time.

    Returns:
        ``output_root/YYYY-MM-DD/HH-MM-SS_task``, with ``_2``, ``_3``... where that is taken.

    Raises:
        ConfigError: The folder cannot be made; says why.
    """
    root = Path(output_root)
    moment = now or datetime.now()
    name = f"{moment:%H-%M-%S}_{re.sub(r'[^A-Za-z0-9._-]+', '-', task)}"
    day = root / f"{moment:%Y-%m-%d}"
    try:
        day.mkdir(parents=True, exist_ok=True)
        folder = _make_new(day, name)
        _point_latest(root, folder)
    except OSError as error:
        raise ConfigError(f"output_dir: cannot make a run folder in {day}: {error}") from error
    return folder


def adopt(folder: str | Path) -> Path:
    """Take a folder of a fixed name, as a sweep's jobs have, for one run.

    Raises:
        ConfigError: It holds a run already, or cannot be made.
    """
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with (path / "config.yaml").open("x"):
            pass  # whoever makes this file owns the folder
    except FileExistsError as error:
        raise ConfigError(f"{path} holds a run already; it is never used again") from error
    except OSError as error:
        raise ConfigError(f"cannot make the run folder {path}: {error}") from error
    return path


def write_record(folder: Path, resolved: Resolved, argv: Sequence[str] | None = None) -> None:
    """Write ``config.yaml``, ``overrides.yaml``, ``command.txt`` and ``versions.json``.

    Args:
        folder: A claimed folder.
        resolved: The config of the run.
        argv: The command line; None is this process's own.

    Raises:
        ConfigError: Something cannot be written (the disk is full); says what and why.
    """
    command = shlex.join(sys.argv if argv is None else argv)
    files = {
        "config.yaml": dump_yaml(resolved.tree),
        "overrides.yaml": dump_yaml(list(resolved.overrides)),
        "command.txt": f"cd {shlex.quote(str(Path.cwd()))}\n{command}\n",
        "versions.json": json.dumps(installed_versions(), indent=2) + "\n",
    }
    for name, text in files.items():
        try:
            write_text(folder / name, text)
        except OSError as error:
            raise ConfigError(f"cannot write {folder / name}: {error}") from error


def find_run(name: str | Path, output_root: str | Path = "outputs") -> Path:
    """Return the folder of a run that exists.

    Args:
        name: Its path, or ``last`` for what ``latest`` points to.
        output_root: Where ``latest`` is.

    Raises:
        ConfigError: There is no such run.
    """
    path = Path(output_root) / LATEST if str(name) == "last" else Path(name)
    if not path.is_dir():
        there = f" ({Path(output_root) / LATEST} does not exist)" if str(name) == "last" else ""
        raise ConfigError(f"there is no run {str(name)!r}{there}")
    return path.resolve()


def _make_new(day: Path, name: str) -> Path:
    for number in range(1, _MOST_SUFFIXES):
        folder = day / (name if number == 1 else f"{name}_{number}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise FileExistsError(f"{_MOST_SUFFIXES} folders named {name} exist")


def _point_latest(root: Path, folder: Path) -> None:
    """Replace the link in one step; a real file or folder of that name is left alone."""
    link = root / LATEST
    if link.exists() and not link.is_symlink():
        raise FileExistsError(f"{link} is not a link; move it away")
    temporary = root / f".{LATEST}.{folder.parent.name}.{folder.name}"
    temporary.symlink_to(folder.relative_to(root), target_is_directory=True)
    os.replace(temporary, link)
