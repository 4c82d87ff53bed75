"""Ctrl-C and SIGTERM on films, exports and evaluations: what is left is whole, or not there."""

import json
import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.recording import inspect
from tests.helpers.commands import Command, Commands
from tests.recording.film.test_film import pictures

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]
"""coverage's tracer holds a lock in Python: an exception of a signal there leaves it locked."""
GUARD = 240.0
"""Seconds after which something hangs."""
SIGNALS = [signal.SIGINT, signal.SIGTERM]

Started = Callable[..., Command]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of which any export takes some seconds."""
    root = tmp_path_factory.mktemp("log")
    keys = ["num_envs=64", "max_steps=1500", "episodes=100000", "seed=1", f"output_dir={root}"]
    assert main(["run", "task=cart_pole", "policy=random", "--quiet", *keys]) == 0
    return next(root.glob("*/*/rollout.mcap"))


@pytest.fixture
def here(tmp_path: Path) -> Path:
    folder = tmp_path / "here"
    folder.mkdir()
    return folder


@pytest.fixture
def start(commands: Commands, here: Path) -> Iterator[Started]:
    """Starts `embodichain ARGUMENTS` in the test's folder, and waits for a file in it."""
    processes: list[Command] = []

    def begun(pattern: str, *arguments: str) -> Command:
        process = commands.start(*arguments, cwd=here)
        processes.append(process)
        deadline = time.monotonic() + GUARD
        while time.monotonic() < deadline and process.poll() is None:
            if next(here.glob(pattern), None) is not None:
                return process
            time.sleep(0.01)
        process.kill()
        raise AssertionError(f"{pattern} did not come: {process.communicate()}")

    yield begun
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.communicate()


def ended(process: Command, number: signal.Signals) -> str:
    """Send a signal; return what the process then said."""
    process.send_signal(number)
    _, err = process.communicate(timeout=GUARD)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert f"interrupted ({number.name})" in err
    return err


def told(err: str) -> tuple[int, int]:
    """Pictures, and the control step of the last one, as the last line says."""
    found = re.search(r"film of the first (\d+) pictures, up to control step (\d+)$", err.strip())
    assert found is not None, err
    return int(found[1]), int(found[2])


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(
    "words",
    [
        ("replay", "LOG", "--video", "film.mp4", "--env", "3", "--size", "64x48"),
        ("export", "LOG", "--format", "mp4", "-o", "film.mp4", "--env", "3"),
    ],
    ids=["replay", "export"],
)
def test_a_film_ends_and_plays(
    log: Path, start: Started, here: Path, number: signal.Signals, words: tuple[str, ...]
) -> None:
    arguments = [str(log) if word == "LOG" else word for word in words]
    process = start(".*.part.mp4", *arguments)
    count, step = told(ended(process, number))
    assert step == count - 1 < 1499
    assert len(pictures(here / "film.mp4")[1]) == count > 0
    assert [path.name for path in here.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("form", ["csv", "parquet", "hdf5", "lerobot"])
def test_an_export_is_complete_or_there_is_no_file(
    log: Path, start: Started, here: Path, number: signal.Signals, form: str
) -> None:
    process = start(".out.*.part*", "export", str(log), "--format", form, "-o", "out")
    err = ended(process, number)
    assert "nothing was written: an export is complete, or there is no file" in err
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("number", SIGNALS)
def test_an_evaluation_counts_what_was_played(
    start: Started, here: Path, number: signal.Signals
) -> None:
    keys = ("task=cart_pole", "num_envs=8", "episodes=1000000", "output_dir=out")
    process = start("out/20*/*/rollout.mcap", "eval", "random", *keys)
    err = ended(process, number)
    folder = next(here.glob("out/20*/*"))
    assert f"{folder.relative_to(here)} is complete up to there" in err
    found = json.loads((folder / "eval.json").read_text())
    assert found["complete"] is False
    summary = inspect(folder / "rollout.mcap")
    assert summary.complete
    assert summary.steps * 8 == found["env_steps"]


@pytest.mark.parametrize("verb", ["run", "eval"])
def test_the_film_of_a_run_ends_too(start: Started, here: Path, verb: str) -> None:
    first = ["eval", "random"] if verb == "eval" else ["run", "policy=random"]
    keys = ["task=reach", "num_envs=1", "episodes=20", "video=true", "output_dir=out", "seed=3"]
    process = start("out/20*/*/.rollout.*.part.mp4", *first, *keys)
    err = ended(process, signal.SIGTERM)
    folder = next(here.glob("out/20*/*"))
    warned = next(line for line in err.splitlines() if line.startswith("warning: interrupted"))
    count, _ = told(warned)
    assert len(pictures(folder / "rollout.mp4")[1]) == count > 0
    file = "eval.json" if verb == "eval" else "summary.json"
    found = json.loads((folder / file).read_text())
    assert found.get("complete", found.get("status")) in (True, "finished")
    assert list(folder.glob(".*")) == []
