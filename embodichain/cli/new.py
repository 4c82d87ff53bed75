"""`embodichain new task NAME`: writes a task and its test, where the user's own files are.

What is written stands in `new_files`. Nothing that exists is ever changed.
"""

from __future__ import annotations

import importlib.util
import keyword
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from embodichain.cli.app import verb
from embodichain.cli.new_files import Names, task_files
from embodichain.cli.new_robot import UR10, describe_robot
from embodichain.cli.output import print_json
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = ["command"]


@dataclass(frozen=True, slots=True)
class Place:
    """Where the files of a task go.

    Attributes:
        package: The user's package; empty in a folder without one.
        source: Its folder's parent, relative to the working directory: what Python must search.
        needed: What its `pyproject.toml` lacks, so that the task is in its wheel and is found where
            that is installed.
    """

    package: str = ""
    source: Path = Path()
    needed: str = ""


def _complete(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    return ["task"] if "task".startswith(incomplete) else []


@verb(
    "new",
    ("new task my_reach", "YAML: conf/task/my_reach.yaml and tests/test_my_reach.py"),
    ("new task my_reach --python", "a class, and the YAML that names it"),
    (
        "new task my_pick --robot panda_description/urdf/panda.urdf",
        "for a robot of yours: its joints, its links",
    ),
)
@click.argument("what", metavar="task", shell_complete=_complete)
@click.argument("name", metavar="NAME")
@click.option("--python", is_flag=True, help="A class instead of YAML alone.")
@click.option("--robot", metavar="FILE", help="Its URDF or MJCF: embodichain list robots.")
def command(what: str, name: str, python: bool, robot: str | None, json: bool) -> None:
    """Write the files and say what to do next.

    Raises:
        ConfigError: If the name cannot be used, or a file exists; nothing is written.
    """
    if what != "task":
        hint = did_you_mean(what, ["task"])
        raise ConfigError(f"nothing called '{what}' can be made.{hint} One of: task")
    name = _checked(name)
    place = _place(name, python=python)
    module = f"{place.package}.tasks.{name}" if place.package else name
    names = Names(name, module, place.source, place.package)
    if python and not place.package:
        _check_module(name)
    facts = UR10 if robot is None else describe_robot(robot)
    files = task_files(names, facts, python=python)
    _write(files)
    made = {path.as_posix(): None for path in files}
    commands = _next(names)
    if json:
        print_json({"wrote": list(made), "next": commands, "pyproject": place.needed})
        return
    lines = [f"wrote {path}" for path in made]
    lines += ["", "next:", *(f"  {command}" for command in commands)]
    if place.needed:
        lines += ["", "to find it where the package is installed, pyproject.toml needs:"]
        lines += [f"  {line}".rstrip() for line in place.needed.splitlines()]
    sys.stdout.write("\n".join(lines) + "\n")


def _checked(name: str) -> str:
    """Return a name that Python and YAML take, and no task has.

    Raises:
        ConfigError: If it is another.
    """
    if not (name.isidentifier() and name.isascii()) or keyword.iskeyword(name):
        raise ConfigError(f"'{name}' is no name for a task: letters, digits and _, as in push_cube")
    from embodichain.config.composed import list_options

    own = Path("conf", "task", f"{name}.yaml")
    if name in list_options("task") and not own.exists():
        raise ConfigError(f"there is a task '{name}' already: embodichain show task={name}")
    return name


def _check_module(name: str) -> None:
    """Refuse a module that another one would hide."""
    if importlib.util.find_spec(name) is not None and not Path(f"{name}.py").exists():
        raise ConfigError(f"Python has a module '{name}' already: choose another name")


def _place(name: str, *, python: bool) -> Place:
    """The package whose `pyproject.toml` lies here, else the working directory itself."""
    file = _pyproject()
    project = file.get("project", {})
    package = str(project.get("name", "")).replace("-", "_").replace(".", "_")
    for source in (Path(), Path("src")):
        if package and (source / package / "__init__.py").is_file():
            return Place(package, source, _needed(file, package, name, python=python))
    return Place()


def _pyproject() -> dict[str, Any]:
    try:
        file = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise ConfigError(f"pyproject.toml cannot be read: {error}") from error
    return file


def _needed(file: dict[str, Any], package: str, name: str, *, python: bool) -> str:
    """The entry points that a package does not have yet, and its YAML in its wheel, as TOML."""
    if package == "embodichain":  # its own tree is searched anyway
        return ""
    groups = file.get("project", {}).get("entry-points", {})
    wanted = [("embodichain.conf", package, f"{package}.conf")]
    if python:
        wanted.append(("embodichain.tasks", name, f"{package}.tasks.{name}"))
    blocks = [
        _block(f'project.entry-points."{group}"', f'{key} = "{value}"', there=group in groups)
        for group, key, value in wanted
        if value not in groups.get(group, {}).values()
    ]
    if _leaves_yaml_out(file, package):
        data = file.get("tool", {}).get("setuptools", {}).get("package-data")
        line = f'{package} = ["conf/**/*.yaml"]'
        blocks.append(_block("tool.setuptools.package-data", line, there=data is not None))
    return "\n\n".join(blocks)


def _block(table: str, line: str, *, there: bool) -> str:
    """A line of a TOML table; a table cannot be written twice."""
    return f"# in [{table}], which is there:\n{line}" if there else f"[{table}]\n{line}"


def _leaves_yaml_out(file: dict[str, Any], package: str) -> bool:
    """Whether wheels hold Python files only: setuptools needs to be told of others."""
    backend = file.get("build-system", {}).get("build-backend", "setuptools.build_meta")
    if not str(backend).startswith("setuptools"):
        return False
    named: dict[str, list[str]] = file.get("tool", {}).get("setuptools", {}).get("package-data", {})
    patterns = {
        f"{folder}/{pattern}".lstrip("/")
        for folder, key in (("", package), ("conf", f"{package}.conf"), ("conf", "*"))
        for pattern in named.get(key, [])
    }
    return not any(pattern.startswith("conf/**/*.y") for pattern in patterns)


def _write(files: dict[Path, str]) -> None:
    """Write new files and their folders.

    Raises:
        ConfigError: If one exists (nothing is written then), or cannot be written.
    """
    there = [path.as_posix() for path in files if path.exists() or path.is_symlink()]
    if there:
        raise ConfigError(f"exists already, and is not overwritten: {', '.join(there)}")
    for path, text in files.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("x", encoding="utf-8") as stream:
                stream.write(text)
        except OSError as error:
            raise ConfigError(f"{path} cannot be written: {error.strerror}") from error


def _next(names: Names) -> list[str]:
    """What to type now."""
    where = "" if names.conf == Path("conf") else f" --config-dir {names.conf.as_posix()}"
    if names.package == "embodichain":
        where = ""
    return [
        f"embodichain validate{where} task={names.task}",
        f"python -m pytest {names.test.as_posix()}",
        f"embodichain run{where} task={names.task}",
    ]
