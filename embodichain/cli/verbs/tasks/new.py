"""`embodichain new task NAME`: writes a task and its test into the user's folder or package.

The files are made from `templates/`. Existing files are not changed.
"""

from __future__ import annotations

import importlib.util
import keyword
import os
import sys
import tomllib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import click

from embodichain.cli.new_task.new_robot import UR10, describe_robot
from embodichain.cli.new_task.new_time_step import TimeStep, time_step
from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import verb
from embodichain.utils.errors import ConfigError

__all__ = ["command"]


@dataclass(frozen=True, slots=True)
class _Names:
    """The names of a task's files.

    Attributes:
        task: The task's name.
        package: The user's package for the files; empty in a folder without one.
        source: The folder to add to Python's path for them, relative to the working directory.
    """

    task: str
    package: str = ""
    source: Path = Path()

    @property
    def module(self) -> str:
        """The module of the class of the task."""
        return f"{self.package}.tasks.{self.task}" if self.package else self.task

    @property
    def cls(self) -> str:
        """The name of the class: ``push_cube`` gives ``PushCubeEnv``."""
        return "".join(part[:1].upper() + part[1:] for part in self.task.split("_")) + "Env"

    @property
    def conf(self) -> Path:
        """The folder of the YAML tree; the file is written into its `task` folder."""
        return self._inside("conf") if self.package else Path("conf")

    @property
    def python(self) -> Path:
        """The file of the class."""
        folder = self._inside("tasks") if self.package else self.source
        return folder / f"{self.task}.py"

    @property
    def test(self) -> Path:
        """The test."""
        tests = Path("tests", "tasks")
        return (tests if tests.is_dir() else tests.parent) / f"test_{self.task}.py"

    def _inside(self, name: str) -> Path:
        """A folder of the package, with links resolved."""
        folder = self.source / self.package / name
        return Path(os.path.relpath(folder.resolve())) if folder.is_symlink() else folder


@dataclass(frozen=True)
class NewOptions:
    """What was typed after `new`.

    Attributes:
        what: ``task``; there is nothing else yet.
        name: The name of the task.
        python: Write a class instead of YAML alone.
        robot: Path of the robot's URDF or MJCF.
        json: Print the result as one JSON object.
    """

    what: str
    name: str
    python: bool
    robot: str | None
    json: bool


@verb(
    "new",
    ("new task my_reach", "YAML: conf/task/my_reach.yaml and tests/test_my_reach.py"),
    ("new task my_reach --python", "a class, and the YAML that names it"),
    (
        "new task my_pick --robot panda_description/urdf/panda.urdf",
        "for a robot of yours: its joints, its links",
    ),
    options=NewOptions,
)
@click.argument("what", metavar="task", type=click.Choice(["task"]))
@click.argument("name", metavar="NAME")
@click.option("--python", is_flag=True, help="A class instead of YAML alone.")
@click.option("--robot", metavar="FILE", help="Its URDF or MJCF: embodichain list robots.")
def command(options: NewOptions) -> None:
    """Write the files and print what to do next.

    Raises:
        ConfigError: If the name is not allowed, or a file exists; nothing is written.
    """
    _check_name(options.name)
    project = _pyproject()
    names = _names(options.name, project)
    own = names.package or Path(f"{options.name}.py").exists()
    if options.python and not own and importlib.util.find_spec(options.name) is not None:
        raise ConfigError(f"Python has a module '{options.name}' already: choose another name")
    words, step = UR10, TimeStep(0.005)
    if options.robot is not None:
        words, files_own = describe_robot(options.robot, python=options.python)
        step = time_step(files_own, lambda tried: _yaml(words | tried.words))
    words = words | step.words
    files = _files(names, words, python=options.python)
    _write(files)
    needed = _needed(project, names, python=options.python)
    written, commands = [path.as_posix() for path in files], _next(names)
    if options.json:
        data = {"wrote": written, "next": commands, "pyproject": needed}
        print_json(data | {"physics_dt": step.dt, "why": step.why} if step.why else data)
        return
    lines = [f"wrote {path}" for path in written]
    if step.why:
        lines.append(f"physics_dt {step.dt:g} s: {step.why}")
    lines += ["", "next:", *(f"  {command}" for command in commands)]
    if needed:
        lines += ["", "to find it where the package is installed, pyproject.toml needs:"]
        lines += [f"  {line}".rstrip() for line in needed.splitlines()]
    sys.stdout.write("\n".join(lines) + "\n")


def _check_name(name: str) -> None:
    """Refuse a name that Python or YAML does not allow, or that another task has."""
    if not (name.isidentifier() and name.isascii()) or keyword.iskeyword(name):
        raise ConfigError(f"'{name}' is no name for a task: letters, digits and _, as in push_cube")
    from embodichain.config.composition.composed import list_options

    own = Path("conf", "task", f"{name}.yaml")
    if name in list_options("task") and not own.exists():
        raise ConfigError(f"there is a task '{name}' already: embodichain show task={name}")


def _pyproject() -> dict[str, Any]:
    try:
        return tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise ConfigError(f"pyproject.toml cannot be read: {error}") from error


def _names(task: str, project: dict[str, Any]) -> _Names:
    """Put the files into the package of the `pyproject.toml` here, else into this folder."""
    name = str(project.get("project", {}).get("name", ""))
    package = name.replace("-", "_").replace(".", "_")
    for source in (Path(), Path("src")):
        if package and (source / package / "__init__.py").is_file():
            return _Names(task, package, source)
    return _Names(task)


def _files(names: _Names, robot: dict[str, str], *, python: bool) -> dict[Path, str]:
    """Path -> text of the files of a task.

    Args:
        names: The names of the files.
        robot: Template variables of the robot, see `describe_robot`.
        python: Whether the task is a class that a short YAML names.
    """
    search = f"    monkeypatch.syspath_prepend({_path('ROOT', names.source)})\n"
    words = {
        "task": names.task,
        "cls": names.cls,
        "id": f"{names.cls.removesuffix('Env') or names.task}-v0",
        "module": names.module,
        "conf": _path("ROOT", names.conf),
        "up": str(len(names.test.parts) - 1),
        "fixture": "monkeypatch: pytest.MonkeyPatch" if python else "",
        "search": search if python else "",
        "hold": "torch.from_numpy(env.action_manager.hold()).float()",
        "success": 'info["success"].tolist()',
        **robot,
    }
    files = {names.conf / "task" / f"{names.task}.yaml": "task.yaml"}
    if python:
        files = {path: "class.yaml" for path in files} | {names.python: "class.py"}
        words["hold"] = "env.robot.get_qpos()[:, env.active_joint_ids]"
    files[names.test] = "test.py"
    templates = resources.files("embodichain.cli") / "templates"
    texts = {
        path: Template((templates / f"{name}.tmpl").read_text(encoding="utf-8")).substitute(words)
        for path, name in files.items()
    }
    inits = {names.conf: "The YAML of this package's tasks."} if names.package else {}
    if names.package and python:
        inits[names.python.parent] = "Tasks."
    missing = {f / "__init__.py": f'"""{text}"""\n' for f, text in inits.items()}
    return texts | {path: text for path, text in missing.items() if not path.exists()}


def _yaml(words: dict[str, str]) -> str:
    """The YAML of a task without a class."""
    templates = resources.files("embodichain.cli") / "templates"
    return Template((templates / "task.yaml.tmpl").read_text(encoding="utf-8")).substitute(words)


def _path(root: str, path: Path) -> str:
    """An expression: ``ROOT / "src" / "conf"``."""
    return " / ".join([root, *(f'"{part}"' for part in path.parts)])


def _write(files: dict[Path, str]) -> None:
    """Write new files and their folders.

    Raises:
        ConfigError: If a file exists (then nothing is written), or cannot be written.
    """
    there = [path.as_posix() for path in files if os.path.lexists(path)]
    if there:
        raise ConfigError(f"exists already, and is not overwritten: {', '.join(there)}")
    for path, text in files.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("x", encoding="utf-8") as stream:
                stream.write(text)
        except OSError as error:
            raise ConfigError(f"{path} cannot be written: {error.strerror}") from error


def _needed(project: dict[str, Any], names: _Names, *, python: bool) -> str:
    """TOML to add to `pyproject.toml`: entry points, and the YAML in the package's wheel."""
    package = names.package
    if package in ("", "embodichain"):  # its tree is always searched
        return ""
    groups = project.get("project", {}).get("entry-points", {})
    wanted = [("embodichain.conf", package, f"{package}.conf")]
    if python:
        wanted.append(("embodichain.tasks", names.task, names.module))
    blocks = [
        _block(f'project.entry-points."{group}"', f'{key} = "{value}"', there=group in groups)
        for group, key, value in wanted
        if value not in groups.get(group, {}).values()
    ]
    backend = str(project.get("build-system", {}).get("build-backend", "setuptools.build_meta"))
    data = project.get("tool", {}).get("setuptools", {}).get("package-data")
    patterns = {
        f"{folder}/{pattern}".lstrip("/")
        for folder, key in (("", package), ("conf", f"{package}.conf"), ("conf", "*"))
        for pattern in (data or {}).get(key, [])
    }
    # by default setuptools puts only Python files into wheels
    if backend.startswith("setuptools") and not any(p.startswith("conf/**/*.y") for p in patterns):
        line = f'{package} = ["conf/**/*.yaml"]'
        blocks.append(_block("tool.setuptools.package-data", line, there=data is not None))
    return "\n\n".join(blocks)


def _block(table: str, line: str, *, there: bool) -> str:
    """A line of a TOML table, with its header unless the file has the table already."""
    return f"# in [{table}], which is there:\n{line}" if there else f"[{table}]\n{line}"


def _next(names: _Names) -> list[str]:
    """The commands to type next."""
    searched = names.conf == Path("conf") or names.package == "embodichain"
    where = "" if searched else f" --config-dir {names.conf.as_posix()}"
    return [
        f"embodichain validate{where} task={names.task}",
        f"python -m pytest {names.test.as_posix()}",
        f"embodichain run{where} task={names.task}",
    ]
