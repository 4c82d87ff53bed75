"""`make` installs once; the system packages are asked for only when missing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

INSTALLED = "#!/bin/sh\necho installed\n"
MISSING = "#!/bin/sh\nexit 1\n"
RECORD = '#!/bin/sh\necho "$(basename "$0") $*" >> "$CALLS"\n'


class Machine:
    """A PATH whose package tools are stand-ins that write down how they were called."""

    def __init__(self, root: Path, script: Path) -> None:
        self.bin, self.calls, self.script = root / "bin", root / "calls", script
        self.bin.mkdir()
        self.calls.touch()
        self.tool("apt-get", RECORD)

    def tool(self, name: str, text: str) -> None:
        (self.bin / name).write_text(text)
        (self.bin / name).chmod(0o755)

    def setup(self, python: str = sys.executable, *more: str) -> subprocess.CompletedProcess[str]:
        path = f"{self.bin}:{os.environ['PATH']}"
        environment = {**os.environ, "PATH": path, "CALLS": str(self.calls)}
        return subprocess.run(
            ["sh", self.script, python, *more],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )


@pytest.fixture
def machine(tmp_path: Path, repo: Path) -> Machine:
    return Machine(tmp_path, repo / "scripts" / "system_deps.sh")


def test_nothing_missing_nothing_done(machine: Machine) -> None:
    machine.tool("dpkg-query", INSTALLED)
    done = machine.setup()
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert machine.calls.read_text() == ""


def test_root_installs_what_is_missing(machine: Machine) -> None:
    machine.tool("dpkg-query", MISSING)
    machine.tool("id", "#!/bin/sh\necho 0\n")
    assert machine.setup().returncode == 0
    assert machine.calls.read_text().splitlines() == [
        "apt-get update",
        "apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri libopengl0",
    ]


def test_tests_want_a_browser_too(machine: Machine) -> None:
    machine.tool("dpkg-query", MISSING)
    machine.tool("id", "#!/bin/sh\necho 0\n")
    assert machine.setup(sys.executable, "chromium").returncode == 0
    assert machine.calls.read_text().splitlines()[-1].endswith(" libopengl0 chromium")


def test_others_are_told_the_command(machine: Machine) -> None:
    machine.tool("dpkg-query", MISSING)
    machine.tool("id", "#!/bin/sh\necho 1000\n")
    done = machine.setup()
    assert done.returncode == 0  # everything but pictures works without
    by_hand = "sudo apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri libopengl0"
    assert by_hand in done.stderr
    assert machine.calls.read_text() == ""


def test_failed_installation_is_said(machine: Machine) -> None:
    machine.tool("dpkg-query", MISSING)
    machine.tool("id", "#!/bin/sh\necho 0\n")
    machine.tool("apt-get", MISSING)
    done = machine.setup()
    assert done.returncode == 0
    found = "could not install: libegl1 libgl1-mesa-dri libopengl0. By hand: apt-get install"
    assert found in done.stderr


def test_python_without_venv_stops(machine: Machine) -> None:
    machine.tool("dpkg-query", INSTALLED)
    machine.tool("id", "#!/bin/sh\necho 1000\n")
    bare = f'#!/bin/sh\ncase "$2" in *ensurepip*) exit 1;; esac\nexec {sys.executable} "$@"\n'
    machine.tool("bare-python", bare)
    done = machine.setup("bare-python")
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    assert done.returncode == 1
    assert f"sudo apt-get install -y --no-install-recommends python{version}-venv" in done.stderr


def make(repo: Path, goal: str, venv: Path) -> str:
    """Lists what `make` would do, without doing it."""
    command = [
        "make",
        "--no-print-directory",
        "-n",
        "-C",
        repo,
        goal,
        f"VENV={venv}",
        f"PYTHON={sys.executable}",
    ]
    # A make above this test would hand its own flags down.
    clean = {k: v for k, v in os.environ.items() if not k.startswith("MAKE")}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=clean)
    return done.stdout


def installs(plan: str) -> list[str]:
    """What would be installed, in this order."""
    commands = (" scripts/locked.py ", " --disable-pip-version-check ")
    found = (line.partition(c)[2] for line in plan.splitlines() for c in commands)
    return [what for what in found if what]


# Hashes first, then the project: pip takes no hashes together with an editable installation.
RUN = ["install", "install --no-compile --no-deps --no-build-isolation -e .", "check"]
REST = ["install --extra dev", "check"]


def test_the_main_job_installs_what_it_needs_and_no_more(repo: Path, tmp_path: Path) -> None:
    plan = make(repo, "run", tmp_path / "venv")
    assert installs(plan) == RUN
    assert "chromium" not in plan
    assert plan.rstrip().endswith("embodichain run task=random_reach num_envs=4")


@pytest.mark.parametrize("goal", ["test", "lint", "types", "imports"])
def test_checks_add_the_rest(repo: Path, tmp_path: Path, goal: str) -> None:
    assert installs(make(repo, goal, tmp_path / "venv")) == [*RUN, *REST]
    (tmp_path / ".installed").touch()
    plan = make(repo, goal, tmp_path)
    assert installs(plan) == REST
    assert "system_deps.sh" in plan
    assert "chromium" in plan


@pytest.mark.parametrize("goal", ["run", "test", "lint", "types", "imports"])
def test_second_call_installs_nothing(repo: Path, tmp_path: Path, goal: str) -> None:
    (tmp_path / ".installed").touch()
    (tmp_path / ".installed-dev").touch()
    assert " install " not in make(repo, goal, tmp_path)


def test_changed_dependencies_install_again(repo: Path, tmp_path: Path) -> None:
    for stamp in (tmp_path / ".installed", tmp_path / ".installed-dev"):
        stamp.touch()
        os.utime(stamp, (0, 0))  # older than pyproject.toml and locked.txt
    assert installs(make(repo, "run", tmp_path)) == RUN
    assert installs(make(repo, "test", tmp_path)) == [*RUN, *REST]


def test_old_python_is_refused(repo: Path, tmp_path: Path) -> None:
    old = tmp_path / "python3.10"
    old.write_text(
        f'#!/bin/sh\nexec {sys.executable} -c "import sys; sys.version_info = (3, 10); $2"\n'
    )
    old.chmod(0o755)
    done = subprocess.run(
        ["make", "-C", repo, "system", f"PYTHON={old}"], capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "Python 3.11 or newer is needed" in done.stderr


def test_bytecode_is_kept_whatever_the_shell_says(
    machine: Machine, repo: Path, tmp_path: Path
) -> None:
    """Each of the processes that tests start would compile its imports again."""
    machine.tool("dpkg-query", INSTALLED)
    for stamp in (".installed", ".installed-dev"):
        (tmp_path / stamp).touch()
    said = "${PYTHONDONTWRITEBYTECODE-kept} $PYTHONPYCACHEPREFIX"
    machine.tool("python", f'#!/bin/sh\necho "{said}"\n')  # of VENV
    command = ["make", "-s", "-C", repo, "test-fast", f"VENV={tmp_path}", "PYTHON=true"]
    shell = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    shell |= {"PATH": f"{machine.bin}:{shell['PATH']}", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=shell)
    assert done.stdout.splitlines()[-1] == f"kept {tmp_path}/bytecode"
