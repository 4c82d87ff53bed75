"""Tries a built wheel as a user gets it: alone with its dependencies, away from the checkout.

`python scripts/smoke.py dist/embodichain-*.whl` makes a virtual environment for every interpreter
of 3.11 to 3.13 that it finds (``python3.X`` on the PATH, or of pyenv), installs the wheel and what
it needs, and runs what a new user runs: see `STEPS`. Interpreters that are not found are named as
untried. The exit code is 1 if a step failed, 2 if no interpreter was found.

Dependencies are those of locked.txt, compared with their hashes, then the wheel without
dependencies, which must not miss one (``--no-pins``: the wheel, and what pip chooses).
``--installed DIR`` makes nothing and tries the environment in DIR.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
VERSIONS = ("3.11", "3.12", "3.13")
TUTORIAL = ROOT / "scripts" / "tutorials" / "gym" / "random_reach.py"
STEPS: dict[str, list[str]] = {
    "import": ["python", "-c", "import embodichain; print(embodichain.__version__)"],
    "version": ["embodichain", "--version"],
    "list": ["embodichain", "list", "tasks"],
    "validate": ["embodichain", "validate", "task=random_reach"],
    "run": ["embodichain", "run", "task=random_reach", "num_envs=2", "--quiet"],
    "replay": ["embodichain", "replay", "last", "--verify"],
    "tutorial": ["python", "random_reach.py", "--headless", "--num_envs", "2"],
}
"""Name -> command. The first word is a program of the environment; the tutorial is copied there."""
_STEP_SECONDS = 600
_OURS = ("PYTHON", "COV", "PYTEST", "VIRTUAL_ENV")
"""Beginnings of variables that lead a process to another environment."""
_SAID = 2000  # characters of a failed step's output that are kept


@dataclass
class Outcome:
    """What one environment did.

    Attributes:
        interpreter: Its version, such as ``3.11.7``.
        packages: Versions of what decides most: torch, mujoco, numpy.
        passed: Names of the steps that worked, in their order.
        failed: Name of the first step that did not, or empty; later ones are not run.
        said: The end of what it printed.
        seconds: Time of all steps, without the installation.
    """

    interpreter: str
    packages: dict[str, str] = field(default_factory=dict)
    passed: list[str] = field(default_factory=list)
    failed: str = ""
    said: str = ""
    seconds: float = 0.0


def interpreters(versions: Sequence[str] = VERSIONS) -> Iterator[tuple[str, Path | None]]:
    """Finds an interpreter that can make environments, for each version.

    A name on the PATH is tried, not trusted: pyenv has one for versions that do not run.

    Yields:
        The version, and the interpreter's path, or None if there is none.
    """
    homes = sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob("versions/*"))
    for version in versions:
        name = f"python{version}"
        found = [shutil.which(name), sys.executable, *(home / "bin" / name for home in homes)]
        tried = (Path(path) for path in found if path and Path(path).is_file())
        yield version, next((path for path in tried if _is(path, version)), None)


def _is(python: Path, version: str) -> bool:
    code = "import ensurepip, sys, venv; print('%d.%d' % sys.version_info[:2])"
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
    return done.returncode == 0 and done.stdout.strip() == version


def installed(python: Path, wheel: Path, place: Path, *, locked: bool) -> Path:
    """Makes an environment with a wheel and what it needs.

    Args:
        python: The interpreter.
        wheel: The project's.
        place: The environment's folder.
        locked: Whether its dependencies are those of locked.txt; else pip chooses, torch first:
            asked for by another package, pip would not prefer a build for CPUs.

    Raises:
        subprocess.CalledProcessError: If something could not be installed, or is missing.
    """
    subprocess.run([python, "-m", "venv", place], check=True)
    own = place / "bin" / "python"
    pip = [own, "-m", "pip", "--disable-pip-version-check"]
    add = [*pip, "install", "-q", "--no-compile"]
    if locked:
        subprocess.run([own, ROOT / "scripts" / "locked.py", "install"], check=True)
        subprocess.run([*add, "--no-deps", wheel], check=True)
        subprocess.run([*pip, "check"], check=True)
        return place
    for what in ("torch", wheel):
        subprocess.run([*add, what], check=True)
    return place


def tried(place: Path, steps: dict[str, list[str]] | None = None) -> Outcome:
    """Runs the steps in an environment, in an empty folder, until one fails."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith(_OURS)}
    outcome = Outcome(_said([place / "bin" / "python", "-c", _VERSION], clean))
    outcome.packages = json.loads(_said([place / "bin" / "python", "-c", _PACKAGES], clean))
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(TUTORIAL, folder)
        for name, (program, *arguments) in (steps or STEPS).items():
            done = subprocess.run(
                [place / "bin" / program, *arguments],
                cwd=folder,
                env=clean,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=_STEP_SECONDS,
                check=False,
            )
            if done.returncode:
                outcome.failed, outcome.said = name, done.stdout[-_SAID:]
                break
            outcome.passed.append(name)
    outcome.seconds = round(time.monotonic() - began, 1)
    return outcome


_VERSION = "import platform; print(platform.python_version())"
_PACKAGES = """
import importlib.metadata as m, json
print(json.dumps({n: m.version(n) for n in ("torch", "mujoco", "numpy", "hydra-core")}))
"""


def _said(command: list[str | Path], environment: dict[str, str]) -> str:
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    return done.stdout.strip()


def main(arguments: list[str] | None = None) -> int:
    """Tries the wheel; prints a line for each environment, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("wheel", type=Path, nargs="?", help="the wheel; not with --installed")
    parser.add_argument("--python", action="append", default=[], metavar="3.X", help="only these")
    parser.add_argument("--no-pins", action="store_true", help="newest allowed versions")
    parser.add_argument("--installed", type=Path, metavar="DIR", help="try this environment")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    if (options.wheel is None) == (options.installed is None):
        parser.error("give a wheel, or --installed DIR")
    outcomes, missing = [], []
    if options.installed:
        outcomes.append(tried(options.installed.resolve()))
    else:
        for version, python in interpreters(options.python or VERSIONS):
            if python is None:
                missing.append(version)
                continue
            with tempfile.TemporaryDirectory(prefix="smoke-") as folder:
                print(f"Python {version}: {python}", file=sys.stderr, flush=True)
                place = Path(folder, "env")
                installed(python, options.wheel.resolve(), place, locked=not options.no_pins)
                outcomes.append(tried(place))
    if options.json:
        print(json.dumps({"tried": [asdict(o) for o in outcomes], "not found": missing}, indent=1))
    else:
        _print(outcomes, missing)
    return 2 if not outcomes else int(any(outcome.failed for outcome in outcomes))


def _print(outcomes: list[Outcome], missing: list[str]) -> None:
    for outcome in outcomes:
        packages = ", ".join(f"{name} {version}" for name, version in outcome.packages.items())
        result = f"FAILED: {outcome.failed}" if outcome.failed else "ok"
        print(f"Python {outcome.interpreter} ({packages}): {result} in {outcome.seconds} s")
        print(f"  passed: {', '.join(outcome.passed)}")
        if outcome.failed:
            print(outcome.said)
    for version in missing:
        print(f"Python {version}: not found, untried")


if __name__ == "__main__":
    sys.exit(main())
