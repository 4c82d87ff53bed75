"""Try a built wheel as a user gets it: alone with its dependencies, away from the checkout.

`python scripts/smoke.py dist/embodichain-*.whl` makes a virtual environment for every interpreter
of 3.11 to 3.13 that it finds (``python3.X`` on the PATH, or of pyenv), installs the wheel and its
dependencies, and runs the commands of a new user, `STEPS`. Interpreters that are not found are
named as untried. The exit code is 1 if a step failed, 2 if no interpreter was found.

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
"""Time after which a step has failed."""
_OF_THIS_ENVIRONMENT = ("PYTHON", "COV", "PYTEST", "VIRTUAL_ENV")
"""Beginnings of variables that lead a process to this environment instead of the new one."""
_SHOWN_CHARACTERS = 2000
"""Characters of a failed step's output, from its end, that a result has."""


@dataclass
class Outcome:
    """Results of the steps in one environment.

    Attributes:
        interpreter: Its version, such as ``3.11.7``.
        packages: Versions of the packages that matter most.
        passed: Names of the steps that worked, in their order.
        failed: Name of the first step that did not, or empty; later ones are not run.
        said: The end of the output of that step.
        seconds: Time of all steps, without the installation.
    """

    interpreter: str
    packages: dict[str, str] = field(default_factory=dict)
    passed: list[str] = field(default_factory=list)
    failed: str = ""
    said: str = ""
    seconds: float = 0.0


def interpreters(versions: Sequence[str] = VERSIONS) -> Iterator[tuple[str, Path | None]]:
    """Find an interpreter that can make environments, for each version.

    Interpreters are run once: pyenv puts names of versions on the PATH that do not run.

    Yields:
        The version, and the interpreter's path, or None if there is none.
    """
    homes = sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob("versions/*"))
    for version in versions:
        name = f"python{version}"
        candidates: list[Path] = []
        on_path = shutil.which(name)
        if on_path is not None:
            candidates.append(Path(on_path))
        candidates.append(Path(sys.executable))
        candidates += [home / "bin" / name for home in homes]
        working = (path for path in candidates if path.is_file() and _is_version(path, version))
        yield version, next(working, None)


def _is_version(python: Path, version: str) -> bool:
    """Whether an interpreter runs, can make environments, and has a version."""
    code = "import ensurepip, sys, venv; print('%d.%d' % sys.version_info[:2])"
    process = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
    return process.returncode == 0 and process.stdout.strip() == version


def install(python: Path, wheel: Path, place: Path, *, locked: bool) -> None:
    """Make an environment with a wheel and its dependencies.

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
    env_python = place / "bin" / "python"
    pip = [env_python, "-m", "pip", "--disable-pip-version-check"]
    pip_install = [*pip, "install", "-q", "--no-compile"]
    if locked:
        subprocess.run([env_python, ROOT / "scripts" / "locked.py", "install"], check=True)
        subprocess.run([*pip_install, "--no-deps", wheel], check=True)
        subprocess.run([*pip, "check"], check=True)
        return
    subprocess.run([*pip_install, "torch"], check=True)
    subprocess.run([*pip_install, wheel], check=True)


def run_steps(place: Path, steps: dict[str, list[str]] | None = None) -> Outcome:
    """Run the steps in an environment, in an empty folder, until one fails."""
    variables = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(_OF_THIS_ENVIRONMENT)
    }
    python = place / "bin" / "python"
    outcome = Outcome(_output_of([python, "-c", _VERSION], variables))
    outcome.packages = json.loads(_output_of([python, "-c", _PACKAGES], variables))
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(TUTORIAL, folder)
        for name, (program, *arguments) in (steps or STEPS).items():
            process = subprocess.run(
                [place / "bin" / program, *arguments],
                cwd=folder,
                env=variables,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=_STEP_SECONDS,
                check=False,
            )
            if process.returncode:
                outcome.failed = name
                outcome.said = process.stdout[-_SHOWN_CHARACTERS:]
                break
            outcome.passed.append(name)
    outcome.seconds = round(time.monotonic() - started, 1)
    return outcome


_VERSION = "import platform; print(platform.python_version())"
_PACKAGES = """
import importlib.metadata as m, json
print(json.dumps({n: m.version(n) for n in ("torch", "mujoco", "numpy", "hydra-core")}))
"""


def _output_of(command: list[str | Path], variables: dict[str, str]) -> str:
    """Run a command, and return what it prints."""
    process = subprocess.run(command, check=True, capture_output=True, text=True, env=variables)
    return process.stdout.strip()


def main(arguments: list[str] | None = None) -> int:
    """Try the wheel; print a line for each environment, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("wheel", type=Path, nargs="?", help="the wheel; not with --installed")
    parser.add_argument("--python", action="append", default=[], metavar="3.X", help="only these")
    parser.add_argument("--no-pins", action="store_true", help="newest allowed versions")
    parser.add_argument("--installed", type=Path, metavar="DIR", help="try this environment")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    if (options.wheel is None) == (options.installed is None):
        parser.error("give a wheel, or --installed DIR")
    outcomes: list[Outcome] = []
    missing: list[str] = []
    if options.installed:
        outcomes.append(run_steps(options.installed.resolve()))
    else:
        for version, python in interpreters(options.python or VERSIONS):
            if python is None:
                missing.append(version)
                continue
            with tempfile.TemporaryDirectory(prefix="smoke-") as folder:
                print(f"Python {version}: {python}", file=sys.stderr, flush=True)
                place = Path(folder, "env")
                install(python, options.wheel.resolve(), place, locked=not options.no_pins)
                outcomes.append(run_steps(place))
    if options.json:
        report = {"tried": [asdict(outcome) for outcome in outcomes], "not found": missing}
        print(json.dumps(report, indent=1))
    else:
        _print_table(outcomes, missing)
    if not outcomes:
        return 2
    return int(any(outcome.failed for outcome in outcomes))


def _print_table(outcomes: list[Outcome], missing: list[str]) -> None:
    for outcome in outcomes:
        packages = ", ".join(f"{name} {version}" for name, version in outcome.packages.items())
        result = "ok"
        if outcome.failed:
            result = f"FAILED: {outcome.failed}"
        print(f"Python {outcome.interpreter} ({packages}): {result} in {outcome.seconds} s")
        print(f"  passed: {', '.join(outcome.passed)}")
        if outcome.failed:
            print(outcome.said)
    for version in missing:
        print(f"Python {version}: not found, untried")


if __name__ == "__main__":
    sys.exit(main())
