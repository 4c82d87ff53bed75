"""Limits of other systems, locks, memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from embodichain.utils.errors import ConfigError
from embodichain.utils.system import platforms


def test_linux_lacks_nothing() -> None:
    assert platforms.limits() == []
    platforms.need(*(limit.feature for limit in platforms.LIMITS))


def test_what_a_system_lacks_is_refused_with_what_works(monkeypatch: pytest.MonkeyPatch) -> None:
    # Windows, as far as one variable can tell it.
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(ConfigError) as caught:
        platforms.need("viewer=web", "record=none", "SIGUSR2")  # a limit, but none that is refused
    (problem,) = caught.value.problems
    assert problem.path == "viewer"
    assert problem.message == ("viewer=web does not work on Windows: its process inherits a socket")
    assert problem.hint == "Instead: viewer=native, or Linux in WSL"


def test_macos_writes_logs_and_has_no_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    # macOS, as far as one variable can tell it.
    monkeypatch.setattr(sys, "platform", "darwin")
    platforms.need("record=mcap", "viewer=web", "collect")
    names = {limit.feature for limit in platforms.limits()}
    assert "sim.engine=warp on CUDA" in names
    assert "record=mcap" not in names


def test_a_lock_keeps_other_processes_out(tmp_path: Path) -> None:
    code = """
import os, sys
from embodichain.utils.system import platforms
try:
    platforms.lock(os.open(sys.argv[1], os.O_RDWR))
except BlockingIOError:
    print("locked")
"""
    path = tmp_path / "file"
    path.touch()
    descriptor = os.open(path, os.O_RDWR)
    platforms.lock(descriptor)
    other = [sys.executable, "-c", code, path]
    done = subprocess.run(other, capture_output=True, text=True, check=True)
    assert done.stdout == "locked\n"
    os.close(descriptor)
    done = subprocess.run(other, capture_output=True, text=True, check=True)
    assert done.stdout == ""


def test_a_lock_is_refused_where_there_is_none(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # Windows, as far as one variable can tell it.
    monkeypatch.setattr(sys, "platform", "win32")
    with (tmp_path / "file").open("w") as stream, pytest.raises(ConfigError, match="on Windows"):
        platforms.lock(stream.fileno())


def test_memory_is_that_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    total = Path("/proc/meminfo").read_text().split("MemTotal:")[1].split()[0]
    assert platforms.memory_bytes() == int(total) * 1024
    monkeypatch.delattr(os, "sysconf")
    assert platforms.memory_bytes() == float("inf")
