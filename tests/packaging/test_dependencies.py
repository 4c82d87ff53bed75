"""Declared, pinned and imported dependencies agree."""

import ast
import importlib.metadata as metadata
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts.pins import closure


@pytest.fixture(scope="module")
def project(repo: Path) -> dict[str, Any]:
    return tomllib.loads((repo / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def pins(repo: Path) -> dict[str, str]:
    lines = (repo / "constraints.txt").read_text().splitlines()
    asked = [Requirement(line) for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"==\d[\w.!]*", str(r.specifier)) for r in asked)  # exact
    return {r.name: str(r.specifier).removeprefix("==") for r in asked}


def names(requirements: list[str]) -> set[str]:
    return {canonicalize_name(Requirement(r).name) for r in requirements}


def imports(repo: Path) -> dict[str, set[str]]:
    """Third-party distribution -> our modules that import it, wherever in the module."""
    owners = metadata.packages_distributions()
    found: dict[str, set[str]] = {}
    for path in [p for top in ("embodichain", "tasks") for p in (repo / top).rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                modules = [node.module or ""]
            tops = {m.partition(".")[0] for m in modules} - {
                "embodichain",
                *sys.stdlib_module_names,
            }
            for top in tops:
                # mujoco-core and others own parts of `mujoco`: the one of that name is meant.
                owner = top if top in owners.get(top, []) else owners.get(top, [top])[0]
                found.setdefault(canonicalize_name(owner), set()).add(str(path.relative_to(repo)))
    return found


def test_what_is_imported_is_declared(repo: Path, project: dict[str, Any]) -> None:
    extras = project["optional-dependencies"]
    optional = set().union(*(names(extras[n]) for n in extras if n != "dev"))
    declared = names(project["dependencies"]) | optional
    assert {n: m for n, m in imports(repo).items() if n not in declared} == {}


def test_what_is_declared_is_imported(repo: Path, project: dict[str, Any]) -> None:
    assert names(project["dependencies"]) - set(imports(repo)) == set()


def test_every_package_that_is_needed_is_pinned(pins: dict[str, str]) -> None:
    """A missing or left-over line: `make pins` writes the file anew."""
    assert set(pins) == set(closure(Requirement("embodichain[dev]")))


def test_pins_are_within_the_declared_ranges(project: dict[str, Any], pins: dict[str, str]) -> None:
    declared = [*project["dependencies"], *sum(project["optional-dependencies"].values(), [])]
    requirements = [r for r in map(Requirement, declared) if r.name != "embodichain"]
    outside = [str(r) for r in requirements if pins[canonicalize_name(r.name)] not in r.specifier]
    assert outside == []


def test_version_is_one(project: dict[str, Any]) -> None:
    import embodichain

    assert "version" not in project
    assert metadata.version("embodichain") == embodichain.__version__
