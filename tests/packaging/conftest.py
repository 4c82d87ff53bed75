"""The tree as git knows it: the checkout's root and its tracked files."""

import os
import subprocess
from pathlib import Path

import pytest

REPO = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def repo() -> Path:
    return REPO


@pytest.fixture(scope="session")
def tracked() -> dict[str, str]:
    """Path from the root -> git's mode (120000 is a link) of what is tracked and there."""
    listing = subprocess.run(
        ["git", "ls-files", "--stage", "-z"], cwd=REPO, check=True, capture_output=True, text=True
    ).stdout
    entries = (entry.split("\t", 1) for entry in listing.split("\0") if entry)
    modes = {path: meta.split()[0] for meta, path in entries}
    return {path: mode for path, mode in modes.items() if os.path.lexists(REPO / path)}
