"""What every test gets: an empty working directory, Ctrl-C, and one thread for torch.

`make coverage` adds half to the CPU time of a test. Tests of whole pages, of benchmarks or of all
terms, whose lines the tests of single modules cover, are marked `unmeasured`.
"""

import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.commands import Commands, commands
from tests.helpers.costs import *  # noqa: F403  (hooks: the tiers, and what a module costs)

if "PYTEST_XDIST_WORKER" in os.environ:
    # As many workers as cores: torch's own threads would only take turns. The engine's threads,
    # which tests choose by number, are not OpenMP's.
    os.environ.setdefault("OMP_NUM_THREADS", "1")


# xdist sets it, and tables would be folded to it: commands are tested as in a pipe.
os.environ.pop("COLUMNS", None)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collects without the garbage collector, which finds little: a quarter of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish() -> None:
    """Spares the garbage collector what stays until the end: modules and thousands of tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def ctrl_c() -> Iterator[None]:
    """Handles SIGINT as in a terminal: a shell's background jobs (`make test &`) ignore it.

    Processes that tests start inherit this.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session", name="commands")
def commands_of_this_session() -> Iterator[Commands]:
    """Starts `embodichain ARGUMENTS` in processes that need not import everything anew."""
    with commands() as started:
        yield started


@pytest.fixture(autouse=True)
def empty_cwd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Runs each test in its own empty folder, so that none writes into the checkout."""
    cwd = tmp_path / "cwd"
    cwd.mkdir()
    monkeypatch.chdir(cwd)
    return cwd


@pytest.fixture(autouse=True)
def without_coverage(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Executes a test marked `unmeasured`, and the processes that it starts, without coverage.

    pytest-cov's own `no_cover` has no effect in the workers of xdist: coverage, which each of them
    starts as a subprocess, continues there.
    """
    if request.node.get_closest_marker("unmeasured") is None:
        yield
        return
    monkeypatch.delenv("COVERAGE_PROCESS_CONFIG", raising=False)
    main, threads = sys.gettrace(), threading.gettrace()
    sys.settrace(None)
    threading.settrace(None)
    yield
    threading.settrace(threads)
    sys.settrace(main)
    if thread := sys.modules.get("embodichain.lab.sim.drawing.thread"):
        # it serves later tests too, and may have started in this one
        thread.render_thread().call(lambda: sys.gettrace() or sys.settrace(threads))
