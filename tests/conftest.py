"""What every test gets: an empty working directory, and one thread for torch."""

import os
from pathlib import Path

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # Two workers on two cores: torch's own threads would only take turns. The engine's threads,
    # which tests choose by number, are not OpenMP's.
    os.environ.setdefault("OMP_NUM_THREADS", "1")


# xdist sets it, and tables would be folded to it: commands are tested as in a pipe.
os.environ.pop("COLUMNS", None)


@pytest.fixture(autouse=True)
def empty_cwd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Runs each test in its own empty folder, so that none writes into the checkout."""
    cwd = tmp_path / "cwd"
    cwd.mkdir()
    monkeypatch.chdir(cwd)
    return cwd
