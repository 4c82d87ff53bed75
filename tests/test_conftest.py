"""What `conftest.py` gives to every test, and the tiers and costs of `helpers/costs.py`."""

import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

IGNORED = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); import pytest;"
    "sys.exit(pytest.main(['-q', '-p', 'no:cacheprovider', *sys.argv[1:]]))"
)


def test_ctrl_c_interrupts_a_test_and_what_it_starts() -> None:
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    code = "import signal; print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_ctrl_c_interrupts_a_test_of_a_background_job(request) -> None:
    """As after `make test &`, where the shell has SIGINT ignored."""
    other = test_ctrl_c_interrupts_a_test_and_what_it_starts.__name__
    command = [
        sys.executable,
        "-c",
        IGNORED,
        f"{__file__}::{other}",
        f"--rootdir={request.config.rootpath}",
    ]
    done = subprocess.run(
        command, cwd=request.config.rootpath, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


MODULES = {
    "test_cheap.py": "def test_it():\n    pass\n",
    "test_costly.py": """\
import subprocess, sys, pytest
pytestmark = pytest.mark.slow
def test_it():
    code = "import time\\nwhile time.process_time() < 1.0: pass"
    subprocess.run([sys.executable, "-c", code], check=True)
""",
}


def pytest_of(folder: Path, root: Path, *words: str, modules: Mapping[str, str] = MODULES) -> str:
    for name, text in modules.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "tests.helpers.costs",
        "-p",
        "no:cacheprovider",
    ]
    done = subprocess.run(
        [*command, f"--rootdir={folder}", *words, str(folder)],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_what_has_no_mark_is_fast(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    said = pytest_of(tmp_path, request.config.rootpath, "-m", "fast")
    assert "1 passed, 1 deselected" in said


def test_costs_are_those_of_a_modules_processes_too(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Workers of xdist report theirs."""
    said = pytest_of(tmp_path, request.config.rootpath, "-n", "1", "--costs", "1")
    costs = {name: float(number) for number, name in re.findall(r"^ +([\d.]+) (\S.*)$", said, re.M)}
    assert list(costs) == ["fast", "slow", "cluster", "slow test_costly.py"]
    assert costs["slow test_costly.py"] == costs["slow"] >= 1.0 > costs["fast"]
    assert costs["cluster"] == 0.0


def test_spread_gives_each_worker_slow_tests_before_its_last_fast_ones(
    tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten tests of two workers: five each, of which a whole folder is slow."""
    monkeypatch.setenv("PYTEST_XDIST_WORKER_COUNT", "2")
    text = "import pytest\npytestmark = pytest.mark.{}\n"
    two = "def test_1():\n    pass\ndef test_2():\n    pass\n"
    tiers = {"a/test_a.py": "fast", "a/test_b.py": "slow", "b/test_c.py": "cluster"}
    tiers |= {"c/test_d.py": "slow", "d/test_e.py": "fast"}
    modules = {name: text.format(tier) + two for name, tier in tiers.items()}
    listed = pytest_of(tmp_path, request.config.rootpath, "--collect-only", "-q", modules=modules)
    order = re.findall(r"test_(\w)\.py::test_(\d)", listed)
    assert ["".join(test) for test in order] == [
        *("c1", "c2", "d1", "d2", "a1"),
        *("a2", "b1", "b2", "e1", "e2"),
    ]
