"""The tutorial's script, extracted at run time where it is at hand, and this project's own."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from embodichain.utils.errors import DeviceError

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
LISTING = ROOT.parent / "shared" / "seed" / "creating_a_basic_environment.txt"
OWN = ROOT / "scripts" / "tutorials" / "gym" / "random_reach.py"
FLAGS = [
    "--headless --num_envs 4",
    "",
    "--device cpu --renderer hybrid",
    "--renderer fast-rt",
    "--renderer rt",
]


@pytest.fixture
def tutorial(tmp_path):
    """The script of the tutorial's page: numbered lines between two headings."""
    if not LISTING.is_file():
        pytest.skip(f"the tutorial's page is not at hand: {LISTING}")
    lines = LISTING.read_text(encoding="utf-8").splitlines()
    start = lines.index("Code for random_reach.py") + 1
    end = lines.index("The Code Explained#")
    code = [line[3:] for line in lines[start:end] if line[:3].strip().isdigit()]
    path = tmp_path / "tutorial.py"
    path.write_text("\n".join(code) + "\n", encoding="utf-8")
    return path


def _run(script, flags):
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    env["PYTHONPATH"] = str(ROOT)
    return subprocess.run(
        [sys.executable, str(script), *flags.split()],
        env=env,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("flags", FLAGS)
def test_the_tutorials_script_runs_unchanged(tutorial, flags):
    done = _run(tutorial, flags)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Episode:") == done.stdout.count("FPS:") == 10
    envs = 4 if "num_envs" in flags else 1
    assert done.stdout.count(f"Total steps: {100 * envs}\n") == 10
    assert ("no display" in done.stderr) is ("--headless" not in flags)


def test_the_tutorials_script_says_that_cuda_is_not_there(tutorial):
    done = _run(tutorial, "--headless --device cuda")
    assert done.returncode != 0
    last = done.stderr.strip().splitlines()[-1]
    assert "there is no CUDA device here" in last
    assert done.stderr.count("Traceback") == 1


@pytest.fixture
def run_own(monkeypatch, capsys):
    def run(flags):
        monkeypatch.delenv("DISPLAY", raising=False)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        monkeypatch.setattr(sys, "argv", [str(OWN), *flags.split()])
        runpy.run_path(str(OWN), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.mark.parametrize("flags", FLAGS)
def test_our_own_script_runs(run_own, flags, caplog):
    out = run_own(flags)
    envs = 4 if "num_envs" in flags else 1
    assert out.count("FPS:") == 10 and out.count(f": {100 * envs} steps in") == 10
    assert ("no display" in caplog.text) is ("--headless" not in flags)


def test_our_own_script_says_that_cuda_is_not_there(run_own):
    with pytest.raises(DeviceError, match="there is no CUDA device here"):
        run_own("--headless --device cuda")


@pytest.mark.unmeasured
def test_our_own_script_runs_as_a_process():
    done = _run(OWN, "--headless --num_envs 2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("FPS:") == 10 and done.stderr == ""
