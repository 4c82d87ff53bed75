"""Terms of installed packages: found by entry point, and a broken package breaks nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TERMS = '''
from embodichain.lab.gym.envs.managers.terms.registry import register_term

@register_term("event")
def shake_everything(env, env_ids, strength: float = 1.0):
    """Shakes everything there is, as hard as it says.

    Args:
        strength: How hard.
    """
'''


def distribution(folder: Path, name: str, module: str, source: str | None) -> None:
    """Install a package the way pip leaves it on disk; no source: its module is missing."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[embodichain.terms]\n{name}_terms = {module}\n")
    if source is not None:
        (folder / f"{module}.py").write_text(source)


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )


def test_terms_of_an_installed_package_are_listed(tmp_path: Path) -> None:
    distribution(tmp_path, "shaker", "shaker_terms", TERMS)
    done = run(tmp_path, "-m", "embodichain", "list", "terms")
    assert done.returncode == 0, done.stderr
    assert "shake_everything" in done.stdout
    assert "could not be loaded" not in done.stderr


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (None, "ModuleNotFoundError: No module named 'broken_terms'"),
        ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
        ("def f(:", "SyntaxError"),
        (
            TERMS.replace("shake_everything", "randomize_rigid_object_pose"),
            "ValueError: event term 'randomize_rigid_object_pose' is registered already",
        ),
    ],
)
def test_a_broken_package_is_named_and_left_out(tmp_path: Path, source, reason: str) -> None:
    distribution(tmp_path, "broken", "broken_terms", source)
    distribution(tmp_path, "shaker", "shaker_terms", TERMS)
    done = run(tmp_path, "-m", "embodichain", "list", "terms")
    assert done.returncode == 0, done.stderr
    assert "shake_everything" in done.stdout
    assert "randomize_rigid_object_pose" in done.stdout
    assert "entry point 'broken_terms' of broken" in done.stderr
    assert reason in done.stderr
    assert done.stderr.count("could not be loaded") == 1
    assert "Traceback" not in done.stderr


def test_an_unknown_term_says_whose_package_is_broken(tmp_path: Path) -> None:
    distribution(tmp_path, "broken", "broken_terms", "raise RuntimeError('no licence')")
    script = (
        "from embodichain.lab.gym.envs.managers import resolve_term\n"
        "try:\n"
        "    resolve_term('event', 'shake_everything')\n"
        "except ValueError as error:\n"
        "    print(error)\n"
    )
    done = run(tmp_path, "-c", script)
    assert "unknown event term 'shake_everything'" in done.stdout
    assert "entry point 'broken_terms' of broken) could not be loaded" in done.stdout
    assert "RuntimeError: no licence" in done.stdout
