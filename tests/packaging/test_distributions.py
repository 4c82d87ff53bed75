"""Wheel and sdist hold the tree's files and nothing else, and the wheel alone runs the main job."""

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path
from typing import NamedTuple

import pytest

from scripts import release

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

EPOCH = 1767323044  # 2026-01-02 03:04:04 UTC; zip files have even seconds

LINKS = {"conf": "embodichain/conf", "tasks": "embodichain/tasks"}


class Built(NamedTuple):
    wheel: Path  # straight from the tree
    sdist: Path
    wheel_of_sdist: Path
    bill: Path
    tree: Path


@pytest.fixture(scope="module")
def built(repo: Path, tracked: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Built:
    """Builds from a copy of the tracked files: setuptools leaves build/ in the tree it reads."""
    root = tmp_path_factory.mktemp("build")
    for path in tracked:
        target = root / "tree" / path
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(repo / path, target, follow_symlinks=False)
    sdist, wheel_of_sdist, bill, _ = release.build(root / "tree", root / "both", EPOCH)
    command = [sys.executable, "-m", "build", "--no-isolation", "--wheel"]
    done = subprocess.run(
        [*command, "--outdir", root / "direct", root / "tree"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = (root / "direct").glob("*.whl")
    return Built(wheel, sdist, wheel_of_sdist, bill, root / "tree")


def test_the_same_files_give_the_same_bytes(built: Built, tmp_path: Path) -> None:
    """Another folder, other times and modes of the files, another day."""
    tree = tmp_path / "elsewhere"
    shutil.copytree(built.tree, tree, symlinks=True, copy_function=shutil.copy)
    shutil.rmtree(tree / "build", ignore_errors=True)
    for path in tree.rglob("*.py"):
        path.chmod(0o600)
    again = release.build(tree, tmp_path / "dist", EPOCH)
    files = (built.sdist, built.wheel_of_sdist, built.bill)
    for first, second in zip(files, again, strict=False):
        assert first.read_bytes() == second.read_bytes(), first.name
    sums = (tmp_path / "dist" / "SHA256SUMS").read_text().splitlines()
    assert sums == [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}"
        for path in (built.wheel_of_sdist, built.sdist, built.bill)
    ]


def test_times_are_the_commits(built: Built) -> None:
    with tarfile.open(built.sdist) as archive:
        assert {m.mtime for m in archive.getmembers()} == {EPOCH}
        assert {(m.uid, m.uname) for m in archive.getmembers()} == {(0, "")}
    with zipfile.ZipFile(built.wheel_of_sdist) as archive:
        assert {i.date_time for i in archive.infolist()} == {(2026, 1, 2, 3, 4, 4)}


@pytest.fixture(scope="module")
def shipped(tracked: dict[str, str]) -> set[str]:
    """What the tree says must be in both: the package, with the linked folders in their places."""
    paths = {p for p, mode in tracked.items() if p.startswith("embodichain/") and mode != "120000"}
    for folder, place in LINKS.items():
        paths |= {place + p.removeprefix(folder) for p in tracked if p.startswith(f"{folder}/")}
    return paths


def contents(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if ".dist-info/" not in name]
        return {name: archive.read(name) for name in names}


def test_wheel_holds_the_tree_and_nothing_else(built: Built, shipped: set[str]) -> None:
    # A file that is missing here is missing from [tool.setuptools.package-data] in pyproject.toml.
    assert set(contents(built.wheel)) == shipped


def test_wheel_carries_licence_command_and_type_marker(built: Built) -> None:
    with zipfile.ZipFile(built.wheel) as archive:
        info = {n.split(".dist-info/")[1]: n for n in archive.namelist() if ".dist-info/" in n}
        assert "licenses/LICENSE" in info
        assert (
            "embodichain = embodichain.cli:main" in archive.read(info["entry_points.txt"]).decode()
        )
        assert "embodichain/py.typed" in archive.namelist()


def test_sdist_holds_real_files_and_no_tests(built: Built, shipped: set[str]) -> None:
    with tarfile.open(built.sdist) as archive:
        members = [m for m in archive.getmembers() if not m.isdir()]
    assert [m.name for m in members if not m.isreg()] == []
    names = {m.name.split("/", 1)[1] for m in members}
    around = {n for n in names if not n.startswith(("embodichain/", "embodichain.egg-info/"))}
    assert names - around >= shipped
    assert {n for n in names - around if not n.startswith("embodichain.egg-info/")} == shipped
    metadata = {"PKG-INFO", "setup.cfg"}
    assert around - metadata == {
        "CHANGELOG.md",
        "LICENSE",
        "MANIFEST.in",
        "README.md",
        "pyproject.toml",
    }


def test_wheel_from_sdist_is_the_wheel_from_the_tree(built: Built) -> None:
    assert contents(built.wheel_of_sdist) == contents(built.wheel)


@pytest.fixture(scope="module")
def elsewhere(built: Built, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Makes an environment that holds the wheel, and sees this one's packages but not the checkout.

    A path in a .pth file is searched, but the .pth files in it are not read: the editable
    install of the checkout, which is one of those, stays unknown.
    """
    place = tmp_path_factory.mktemp("elsewhere") / "env"
    venv.create(place)
    python = place / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--no-index", "--no-deps"]
    subprocess.run([*pip, built.wheel], check=True, capture_output=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    site = place / "lib" / version / "site-packages"
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return place


def run(command: list[str | Path]) -> subprocess.CompletedProcess[str]:
    """Runs in the (empty) working directory, without what points to the checkout."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "COV", "PYTEST"))}
    return subprocess.run(
        command,
        env=clean,
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
        stdin=subprocess.DEVNULL,
    )


def test_installed_wheel_is_what_python_finds(elsewhere: Path, repo: Path) -> None:
    code = """
import sys
import embodichain.conf, embodichain.tasks
print(embodichain.conf.__file__, embodichain.tasks.__file__, *sys.path)
"""
    done = run([elsewhere / "bin" / "python", "-c", code])
    assert done.returncode == 0, done.stderr
    conf, tasks, *paths = done.stdout.split()
    assert Path(conf).is_relative_to(elsewhere)
    assert Path(tasks).is_relative_to(elsewhere)
    assert str(repo) not in paths


@pytest.mark.parametrize("command", [["embodichain"], ["python", "-m", "embodichain"]])
def test_installed_wheel_has_the_command(elsewhere: Path, command: list[str]) -> None:
    done = run([elsewhere / "bin" / command[0], *command[1:], "--help"])
    assert done.returncode == 0, done.stderr
    assert "run" in done.stdout


def test_installed_wheel_runs_the_main_job(elsewhere: Path, empty_cwd: Path) -> None:
    job = ["run", "task=random_reach", "num_envs=4", "episodes=1", "max_steps=5"]
    done = run([elsewhere / "bin" / "embodichain", *job])
    assert done.returncode == 0, done.stdout + done.stderr
    made = {p.name for p in (empty_cwd / "outputs" / "latest").iterdir()}
    assert {"config.yaml", "rollout.mcap", "summary.json"} <= made


def test_installed_wheel_has_ids_for_gymnasium(elsewhere: Path, empty_cwd: Path) -> None:
    code = """
import gymnasium
env = gymnasium.make("embodichain:embodichain/reach-v0")
print(env.reset(seed=1)[0].shape, gymnasium.make_vec("embodichain/cart_pole-v0", num_envs=2))
"""
    done = run([elsewhere / "bin" / "python", "-c", code])
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("(21,) TaskVectorEnv('cart_pole', num_envs=2, ")
