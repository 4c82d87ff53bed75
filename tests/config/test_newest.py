"""`last`: the newest run that holds what is wanted, whatever ran since."""

import os
from pathlib import Path

import pytest

from embodichain.config.run_folder import CHECKPOINT, LOG, newest_run


@pytest.mark.usefixtures("empty_cwd")
def test_newest_run_with_a_file() -> None:
    runs = {
        "2026-01-02/10-00-00_reach": [CHECKPOINT],
        "sweeps/2026-01-01/09-00-00/1": [CHECKPOINT, LOG],
        "2026-01-03/11-00-00_reach": [LOG],
        "2026-01-04/12-00-00_reach": [],
    }
    for i, (run, files) in enumerate(runs.items()):
        for file in ["config.yaml", *files]:
            path = Path("outputs", run, file)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        os.utime(Path("outputs", run, "config.yaml"), (i, i))
    assert (
        newest_run("outputs", CHECKPOINT) == Path("outputs/sweeps/2026-01-01/09-00-00/1").resolve()
    )
    assert newest_run("outputs", LOG) == Path("outputs/2026-01-03/11-00-00_reach").resolve()
    assert newest_run("outputs", "summary.json") is None
    assert newest_run("nowhere", LOG) is None
