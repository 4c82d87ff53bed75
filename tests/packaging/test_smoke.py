"""`scripts/smoke.py` finds interpreters, and says which step failed; `make smoke` tries wheels."""

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from scripts import smoke

pytestmark = pytest.mark.slow

VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"


@pytest.fixture
def empty_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    return folder


def script(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def test_names_that_do_not_run_are_no_interpreters(empty_path: Path, tmp_path: Path) -> None:
    script(empty_path / "python3.12", "echo 'command not found' >&2; exit 127")
    script(empty_path / "python3.13", "echo 3.12")  # another version
    other = script(tmp_path / "pyenv" / "versions" / "3.12.1" / "bin" / "python3.12", "echo 3.12")
    found = dict(smoke.interpreters(["3.12", "3.13", VERSION]))
    assert found == {"3.12": other, "3.13": None, VERSION: Path(sys.executable)}


def test_without_an_interpreter_nothing_was_tried(
    empty_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert smoke.main([str(tmp_path / "a.whl"), "--python", "3.99"]) == 2
    assert capsys.readouterr().out == "Python 3.99: not found, untried\n"


@pytest.fixture
def environment(tmp_path: Path, repo: Path) -> Path:
    """One whose `embodichain` verb `run` fails."""
    place = tmp_path / "env"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", place], check=True)
    seen = [sysconfig.get_path("purelib"), *(p for p in sys.path if "site-packages" in p), repo]
    paths = "\n".join(map(str, seen))
    (place / "lib" / f"python{VERSION}" / "site-packages" / "seen.pth").write_text(paths)
    script(place / "bin" / "embodichain", 'pwd; echo "did $1"; [ "$1" != run ]')
    return place


def test_the_first_step_that_fails_ends_it_and_is_shown(
    environment: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = os.getcwd()
    assert smoke.main(["--installed", str(environment), "--json"]) == 1
    (outcome,) = json.loads(capsys.readouterr().out)["tried"]
    assert outcome["passed"] == ["import", "version", "list", "validate"]
    assert outcome["failed"] == "run"
    assert outcome["said"].endswith("did run\n")
    assert here not in outcome["said"]  # away from the checkout
    assert outcome["interpreter"].startswith(VERSION)
    assert set(outcome["packages"]) == {"torch", "mujoco", "numpy", "hydra-core"}

    assert smoke.main(["--installed", str(environment)]) == 1
    assert "FAILED: run in" in capsys.readouterr().out
