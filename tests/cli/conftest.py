"""The command as people run it: in a process of its own."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.commands import Commands

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def embodichain(commands: Commands) -> Run:
    """Runs `embodichain ARGUMENTS` in `cwd` and returns what it printed.

    With `env`, which an interpreter or a library may read as it starts, it is a new interpreter.
    """

    def run(
        *arguments: str, cwd: Path | None = None, env: dict[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        if env is None:
            return commands.run(*arguments, cwd=cwd)
        return subprocess.run(
            [sys.executable, "-m", "embodichain", *arguments],
            cwd=cwd,
            env={**os.environ, **env},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    return run
