"""What starts fast stays fast: no torch in help, list, package inits and data classes."""

import subprocess
import sys
from pathlib import Path

import pytest

import embodichain

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

HEAVY = {"torch", "tensordict", "stable_baselines3"}


def imported(arguments: list[str]) -> set[str]:
    """Runs python and returns the top-level modules it imported; fails if it failed."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    lines = done.stderr.splitlines()
    errors = [line for line in lines if not line.startswith("import time:")]
    assert done.returncode == 0, "\n".join([done.stdout, *errors])
    modules = [line.rpartition("|")[2].strip() for line in lines if line not in errors]
    return {module.partition(".")[0] for module in modules}


def test_importtime_names_what_is_imported() -> None:
    assert "torch" in imported(["-c", "import torch"])


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["run", "--help"],
        ["list", "tasks"],
        ["list", "robots"],
        ["list", "terms"],
    ],
    ids=" ".join,
)
def test_command_imports_no_torch(arguments: list[str]) -> None:
    assert HEAVY & imported(["-m", "embodichain", *arguments]) == set()


def test_a_mistake_in_a_config_is_found_without_torch() -> None:
    code = "import sys; from embodichain.cli import main; sys.exit(main(sys.argv[1:]) != 2)"
    found = imported(["-c", code, "run", "task=random_reach", "num_envs=0"])
    assert HEAVY & found == set()


@pytest.mark.parametrize(
    "module",
    ["embodichain.lab.sim.cfg", "embodichain.lab.sim.shapes", "embodichain.lab.gym.envs.cfg"],
)
def test_data_classes_import_no_torch(module: str) -> None:
    assert HEAVY & imported(["-c", f"import {module}"]) == set()


def test_importing_the_package_imports_almost_nothing() -> None:
    third_party = HEAVY | {"mujoco", "numpy", "hydra", "omegaconf", "pydantic", "gymnasium", "rich"}
    assert third_party & imported(["-c", "import embodichain"]) == set()


def test_package_inits_are_lazy(repo: Path) -> None:
    inits = sorted(
        p for top in ("embodichain", "conf", "tasks") for p in (repo / top).rglob("__init__.py")
    )
    names = {".".join(p.parent.relative_to(repo).parts) for p in inits}
    names = {n if n.startswith("embodichain") else f"embodichain.{n}" for n in names}
    assert HEAVY & imported(["-c", "import " + ", ".join(sorted(names))]) == set()


def test_a_run_imports_nothing_of_learning_and_windows(tmp_path: Path) -> None:
    found = imported(
        [
            *("-m", "embodichain", "run", "task=random_reach", "max_steps=1", "--quiet"),
            *("--json", f"output_dir={tmp_path}"),
        ]
    )
    assert "torch" in found
    assert found & {"stable_baselines3", "matplotlib", "pandas", "scipy", "tensorboard"} == set()


def test_torch_is_not_made_a_lazy_module() -> None:
    """From Python 3.12.3 on, `importlib.util.LazyLoader` cannot load torch."""
    sources = Path(embodichain.__file__).parent.rglob("*.py")
    assert [path for path in sources if 'lazy_loader.load("torch")' in path.read_text()] == []
