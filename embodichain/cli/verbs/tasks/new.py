"""`embodichain new task NAME`: writes a task and its test into the user's folder or package.

The files are made from `templates/`. Existing files are not changed.
"""

from __future__ import annotations

import importlib.util
import keyword
import os
import re
import sys
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.new_task.guesses import Guess
from embodichain.cli.new_task.new_robot import UR10, describe_robot
from embodichain.cli.new_task.new_time_step import TimeStep, time_step
from embodichain.cli.new_task.plausibility import warn_of_size
from embodichain.cli.new_task.task_trials import EPISODES, Trial
from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import verb
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import NewEmbodiment

__all__ = ["command"]

KIND_NAMES = ("reach", "push", "pick", "velocity")
"""The kinds of tasks, without the modules that write them."""
_SHIPPED_EMBODIMENTS = {
    "reach": "ur10",
    "push": "ur10_pusher",
    "pick": "ur10_gripper",
    "velocity": "go2",
}
"""Kind -> the embodiment of the shipped task of that kind."""


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
        if not self.package:
            return self.task
        return f"{self.package}.tasks.{self.task}"

    @property
    def class_name(self) -> str:
        """The name of the class: ``push_cube`` gives ``PushCubeEnv``."""
        parts = [part[:1].upper() + part[1:] for part in self.task.split("_")]
        return f"{''.join(parts)}Env"

    @property
    def conf(self) -> Path:
        """The folder of the YAML tree; the file is written into its `task` folder."""
        if not self.package:
            return Path("conf")
        return self._folder_of_package("conf")

    @property
    def python(self) -> Path:
        """The file of the class."""
        folder = self.source
        if self.package:
            folder = self._folder_of_package("tasks")
        return folder / f"{self.task}.py"

    @property
    def test(self) -> Path:
        """The test."""
        folder = Path("tests", "tasks")
        if not folder.is_dir():
            folder = Path("tests")
        return folder / f"test_{self.task}.py"

    def _folder_of_package(self, name: str) -> Path:
        """A folder of the package, with links resolved."""
        folder = self.source / self.package / name
        if folder.is_symlink():
            return Path(os.path.relpath(folder.resolve()))
        return folder


@dataclass(frozen=True)
class NewOptions:
    """What was typed after `new`.

    Attributes:
        what: ``task`` or ``embodiment``.
        name: The name of the task or the embodiment.
        python: Write a class instead of YAML alone.
        robot: Path of the robot's URDF or MJCF.
        kind: The kind of the task; None writes reaching with the robot in the task's own file.
        embodiment: The robot's embodiment, instead of its file.
        feet: The links on which a robot that walks stands, with commas between them.
        json: Print the result as one JSON object.
    """

    what: str
    name: str
    python: bool
    robot: str | None
    kind: str | None
    embodiment: str | None
    feet: str | None
    json: bool

    @property
    def named_feet(self) -> list[str]:
        """The links of `feet`."""
        return [name.strip() for name in (self.feet or "").split(",") if name.strip()]


@verb(
    "new",
    ("new task my_reach", "YAML: conf/task/my_reach.yaml and tests/test_my_reach.py"),
    ("new task my_reach --python", "a class, and the YAML that names it"),
    (
        "new task my_pick --robot panda_description/urdf/panda.urdf",
        "for a robot of yours: its joints, its links",
    ),
    (
        "new task my_pick --kind pick --robot my_arm.xml",
        "a task of a kind, and conf/embodiment/my_arm.yaml",
    ),
    ("new task my_push --kind push --embodiment panda", "for an embodiment that exists"),
    (
        "new embodiment my_arm --robot my_arm.urdf",
        "conf/embodiment/my_arm.yaml: your robot in every task",
    ),
    options=NewOptions,
)
@click.argument("what", metavar="task|embodiment", type=click.Choice(["task", "embodiment"]))
@click.argument("name", metavar="NAME")
@click.option("--python", is_flag=True, help="A class instead of YAML alone.")
@click.option("--robot", metavar="FILE", help="Its URDF or MJCF: embodichain list robots.")
@click.option("--kind", type=click.Choice(KIND_NAMES), help="What is to be done.")
@click.option("--embodiment", metavar="NAME", help="The robot: embodichain list embodiments.")
@click.option("--feet", metavar="LINKS", help="Of a robot that walks: LF_shank,RF_shank,...")
def command(options: NewOptions) -> None:
    """Write the files and print what to do next.

    Raises:
        ConfigError: If the name is not allowed, or a file exists; nothing is written.
    """
    is_for_legs = options.what == "embodiment" or options.kind == "velocity"
    if options.feet is not None and not (is_for_legs and options.robot):
        raise ConfigError(
            "--feet goes with --robot FILE, in `new embodiment` or `new task --kind velocity`"
        )
    if options.what == "embodiment":
        _write_embodiment(options)
        return
    if options.kind is not None or options.embodiment is not None:
        _write_kind(options)
        return
    _check_name(options.name)
    project = _read_pyproject()
    names = _names(options.name, project)
    if options.python:
        _check_module(names)
    robot_words = UR10
    guesses: Sequence[Guess] = ()
    step = TimeStep(0.005)
    if options.robot is not None:
        robot = describe_robot(options.robot, python=options.python)
        robot_words = robot.words
        guesses = robot.guesses
        step = time_step(robot.file_dt, lambda trial: _yaml(robot_words | trial.words))
    files = _files(names, robot_words | step.words, python=options.python)
    _write(files)
    toml = _missing_toml(project, names, python=options.python)
    commands = _next_commands(names)
    commands.append(_train_command(commands[-1]))
    _report(files, step, commands, toml, guesses=guesses, json=options.json)


def _write_embodiment(options: NewOptions) -> None:
    """Write an embodiment, and print what was guessed.

    Raises:
        ConfigError: If there is no robot, the name is not allowed, or the file exists.
    """
    from embodichain.cli.new_task.new_embodiment import (
        command_to_check,
        embodiment_text,
        guess_embodiment,
    )
    from embodichain.config.composition.composed import list_options

    name = options.name
    if options.robot is None:
        raise ConfigError("new embodiment needs the robot's file: --robot FILE")
    for option in ("python", "kind", "embodiment"):
        if getattr(options, option):
            raise ConfigError(f"--{option} goes with `new task`")
    if not (name.isidentifier() and name.isascii()) or keyword.iskeyword(name):
        raise ConfigError(f"'{name}' is not a name for an embodiment: letters, digits and _")
    path = _names(name, _read_pyproject()).conf / "embodiment" / f"{name}.yaml"
    if name in list_options("embodiment") and not path.exists():
        raise ConfigError(f"there is an embodiment '{name}' already: embodichain list embodiments")
    _refuse_existing([path])  # before the robot's file is read
    guesses = guess_embodiment(options.robot, options.named_feet)
    _write({path: embodiment_text(name, guesses)})
    command = command_to_check(name, guesses).replace("embodichain show", "embodichain validate")
    if options.json:
        listed = [{"key": g.key, "value": g.value, "why": g.why} for g in guesses]
        print_json({"wrote": [path.as_posix()], "guessed": listed, "next": [command]})
        return
    lines = [f"wrote {path.as_posix()}", "", "guessed:"]
    lines += [f"  {guess}" for guess in guesses]
    lines += ["", "next:", f"  {command}"]
    sys.stdout.write("\n".join(lines) + "\n")


def _write_kind(options: NewOptions) -> None:
    """Write a task of a kind, and the embodiment of its robot if that is new.

    Raises:
        ConfigError: If the options contradict each other, or the robot cannot do the task.
    """
    from embodichain.cli.new_task.embodied_robot import read_embodiment
    from embodichain.cli.new_task.kind_tests import kind_test_words
    from embodichain.cli.new_task.task_kinds import KINDS, write_kind

    if options.python:
        raise ConfigError("--python writes a task of reaching: leave --kind and --embodiment out")
    if options.robot is not None and options.embodiment is not None:
        raise ConfigError("either --robot or --embodiment: an embodiment has its robot's file")
    _check_name(options.name)
    project = _read_pyproject()
    names = _names(options.name, project)
    yaml_file = names.conf / "task" / f"{names.task}.yaml"
    _refuse_existing([yaml_file, names.test])  # before anything is tried, which takes seconds
    kind = KINDS[options.kind or "reach"]
    choice = _embodiment_of(options, names, kind.name)
    embodiment = choice.embodiment
    robot = read_embodiment(embodiment)
    if not embodiment.is_new:  # else it was said when the robot's file was read
        warn_of_size(robot.parsed)
    task = write_kind(kind, robot)
    alias = robot.parsed.aliases.get("tool")
    words = {
        "task": names.task,
        "conf": _path("ROOT", names.conf),
        "up": str(len(names.test.parts) - 1),
        **kind_test_words(kind.name, alias.kind if alias else "link"),
    }
    files = {}
    guesses = choice.guesses
    if embodiment.is_new:
        path = names.conf / "embodiment" / f"{embodiment.name}.yaml"
        # Another command may have written it while the expert was tried.
        if options.robot is not None and _has_robot(path, options.robot):
            guesses = [_guess_of_existing(path)]
        else:
            files[path] = embodiment.text
    files[yaml_file] = task.text
    files[names.test] = _fill("kind_test.py", words)
    files |= _missing_inits(names, python=False)
    _write(files)
    toml = _missing_toml(project, names, python=False)
    commands = _next_commands(names)
    run = commands[-1]
    if task.trial is not None and task.trial.is_poor:
        commands[-1] = f"{run} policy=expert video=true"
        _warn_of_expert(commands[-1], task.trial)
    else:
        commands.append(_train_command(run))
    _report(
        files,
        task.time_step,
        commands,
        toml,
        guesses=[*guesses, *task.guesses],
        trial=task.trial,
        json=options.json,
    )


@dataclass(frozen=True)
class _EmbodimentChoice:
    """The embodiment of a new task.

    Attributes:
        embodiment: Its name, and its text if it is to be written.
        guesses: What was guessed for that.
    """

    embodiment: NewEmbodiment
    guesses: Sequence[Guess] = ()


def _embodiment_of(options: NewOptions, names: _Names, kind: str) -> _EmbodimentChoice:
    """The embodiment that was named, that of the robot's file, or the one of the shipped task.

    Raises:
        ConfigError: If there is no such embodiment, or the robot's file cannot be read.
    """
    from embodichain.cli.new_task.embodied_robot import NewEmbodiment
    from embodichain.cli.new_task.new_embodiment import embodiment_text, guess_embodiment
    from embodichain.config.composition.composed import list_options
    from embodichain.utils.suggest import did_you_mean

    existing = list_options("embodiment")
    own_files = names.conf / "embodiment"
    if options.robot is None:
        name = options.embodiment or _SHIPPED_EMBODIMENTS[kind]
        path = own_files / f"{name}.yaml"
        if path.exists():
            return _EmbodimentChoice(NewEmbodiment(name, path.read_text(encoding="utf-8")))
        if name not in existing:
            hint = did_you_mean(name, existing)
            raise ConfigError(
                f"there is no embodiment '{name}': embodichain list embodiments{hint}"
            )
        return _EmbodimentChoice(NewEmbodiment(name))
    stem = re.sub(r"\W+", "_", Path(options.robot).stem).strip("_").lower() or "robot"
    if not stem.isidentifier() or not stem.isascii() or keyword.iskeyword(stem):
        stem = f"robot_{stem}" if stem.isascii() else "robot"
    for name in (stem, f"my_{stem}", *(f"my_{stem}{i}" for i in range(2, 100))):
        path = own_files / f"{name}.yaml"
        if not path.exists():
            if name in existing:  # one that ships, with gains and names of its own
                continue
            guesses = guess_embodiment(
                options.robot, options.named_feet, shall_walk=kind == "velocity"
            )
            text = embodiment_text(name, guesses)
            return _EmbodimentChoice(NewEmbodiment(name, text, is_new=True), guesses)
        if _has_robot(path, options.robot):
            if options.feet is not None:
                message = f"--feet: {path.as_posix()} exists, and is not changed"
                raise ConfigError(f"{message}: write names.feet and control_parts.legs there")
            text = path.read_text(encoding="utf-8")
            return _EmbodimentChoice(NewEmbodiment(name, text), [_guess_of_existing(path)])
    raise ConfigError(f"{own_files.as_posix()} has a hundred embodiments of {stem}: choose one")


def _has_robot(path: Path, robot: str) -> bool:
    """Whether a file of an embodiment exists and names a robot's file."""
    return os.path.normpath(_robot_file(path) or "") == os.path.normpath(robot)


def _guess_of_existing(path: Path) -> Guess:
    """The embodiment that is taken because its file exists."""
    why = f"{path.as_posix()}, which exists, has this file"
    return Guess("embodiment", path.stem, why)


def _robot_file(path: Path) -> str | None:
    """The robot's file that an embodiment's file names; None if it cannot be read."""
    import yaml

    try:
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
        return str(tree["robot"]["fpath"])
    except (OSError, yaml.YAMLError, TypeError, KeyError, UnicodeDecodeError):
        return None


def _report(
    files: Iterable[Path],
    step: TimeStep,
    commands: list[str],
    toml: str,
    *,
    guesses: Sequence[Guess] = (),
    trial: Trial | None = None,
    json: bool,
) -> None:
    """Print what was written, and what to do next.

    Args:
        files: The files that were written.
        step: The task's time step.
        commands: The commands to type next.
        toml: What `pyproject.toml` lacks.
        guesses: What was guessed.
        trial: How its expert did; None without one.
        json: Print one JSON object.
    """
    written = [path.as_posix() for path in files]
    if json:
        facts: dict[str, Any] = {"wrote": written, "next": commands, "pyproject": toml}
        if step.why:
            facts["physics_dt"] = step.dt
            facts["why"] = step.why
        if guesses:
            facts["guessed"] = [{"key": g.key, "value": g.value, "why": g.why} for g in guesses]
        if trial is not None:
            facts["expert"] = {
                "success": trial.success,
                "failure": trial.failure,
                "failure_count": trial.failure_count,
            }
        print_json(facts)
        return
    lines = [f"wrote {path}" for path in written]
    if guesses:
        lines += ["", "guessed:", *(f"  {guess}" for guess in guesses), ""]
    if trial is not None:
        lines.append(f"its expert succeeds in {100 * trial.success:.0f} % of {EPISODES} episodes")
        if trial.failure:
            lines.append(f"  most of those that failed: {trial.failure}")
    if step.why:
        lines.append(f"physics_dt {step.dt:g} s: {step.why}")
    lines += ["", "next:"]
    lines += [f"  {command}" for command in commands]
    if toml:
        lines += ["", "to find it where the package is installed, pyproject.toml needs:"]
        lines += [f"  {line}".rstrip() for line in toml.splitlines()]
    sys.stdout.write("\n".join(lines) + "\n")


def _train_command(run: str) -> str:
    """The command that trains the task which a command runs."""
    return run.replace("embodichain run", "embodichain train", 1)


def _warn_of_expert(command: str, trial: Trial) -> None:
    """Print on stderr that a task's own expert mostly fails, why, and what to look at.

    Args:
        command: The command that films it.
        trial: How it did.
    """
    sys.stderr.write(
        f"warning: the task's own expert succeeds in only {100 * trial.success:.0f} % of "
        f"{EPISODES} episodes: do not train before you know why\n"
        f"  most often ({trial.failure_count} times): {trial.failure}\n"
        "  look first at the guesses of the tool, the fingers and drive_pros, and at a film:\n"
        f"  {command}\n"
    )


def _check_name(name: str) -> None:
    """Refuse a name that Python or YAML does not allow, or that another task has."""
    if not (name.isidentifier() and name.isascii()) or keyword.iskeyword(name):
        raise ConfigError(
            f"'{name}' is not a name for a task: letters, digits and _, as in push_cube"
        )
    from embodichain.config.composition.composed import list_options

    users_file = Path("conf", "task", f"{name}.yaml")
    # `_write` refuses the user's own file, by its path.
    if name in list_options("task") and not users_file.exists():
        raise ConfigError(f"there is a task '{name}' already: embodichain show task={name}")


def _check_module(names: _Names) -> None:
    """Refuse a module of the working directory that would hide one of Python's or a package's."""
    if names.package or Path(f"{names.task}.py").exists():
        return
    if importlib.util.find_spec(names.task) is not None:
        raise ConfigError(f"Python has a module '{names.task}' already: choose another name")


def _read_pyproject() -> dict[str, Any]:
    """The content of `pyproject.toml` here; empty if there is none."""
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
    words = {
        "task": names.task,
        "cls": names.class_name,
        "id": f"{names.class_name.removesuffix('Env') or names.task}-v0",
        "module": names.module,
        "conf": _path("ROOT", names.conf),
        "up": str(len(names.test.parts) - 1),
        "fixture": "",
        "search": "",
        "hold": "torch.from_numpy(env.action_manager.hold()).float()",
        "success": 'info["success"].tolist()',
        **robot,
    }
    if python:
        words["fixture"] = "monkeypatch: pytest.MonkeyPatch"
        words["search"] = f"    monkeypatch.syspath_prepend({_path('ROOT', names.source)})\n"
        words["hold"] = "env.robot.get_qpos()[:, env.active_joint_ids]"

    yaml = names.conf / "task" / f"{names.task}.yaml"
    if python:
        files = {
            yaml: _fill("class.yaml", words),
            names.python: _fill("class.py", words),
        }
    else:
        files = {yaml: _fill("task.yaml", words)}
    files[names.test] = _fill("test.py", words)
    return files | _missing_inits(names, python=python)


def _missing_inits(names: _Names, *, python: bool) -> dict[Path, str]:
    """Path -> text of the `__init__.py` that folders of the user's package lack."""
    if not names.package:
        return {}
    docstrings = {names.conf: "The YAML of this package's tasks."}
    if python:
        docstrings[names.python.parent] = "Tasks."
    inits = {}
    for folder, docstring in docstrings.items():
        path = folder / "__init__.py"
        if not path.exists():
            inits[path] = f'"""{docstring}"""\n'
    return inits


def _yaml(words: dict[str, str]) -> str:
    """The YAML of a task without a class."""
    return _fill("task.yaml", words)


def _fill(name: str, words: dict[str, str]) -> str:
    """The text of a template with its variables replaced."""
    template = resources.files("embodichain.cli") / "templates" / f"{name}.tmpl"
    return Template(template.read_text(encoding="utf-8")).substitute(words)


def _path(root: str, path: Path) -> str:
    """An expression: ``ROOT / "src" / "conf"``."""
    return " / ".join([root, *(f'"{part}"' for part in path.parts)])


def _write(files: dict[Path, str]) -> None:
    """Write new files and their folders.

    Raises:
        ConfigError: If a file exists (then nothing is written), or cannot be written.
    """
    _refuse_existing(files)
    for path, text in files.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("x", encoding="utf-8") as stream:
                stream.write(text)
        except OSError as error:
            raise ConfigError(f"{path} cannot be written: {error.strerror}") from error


def _refuse_existing(paths: Iterable[Path]) -> None:
    """Refuse to replace files."""
    existing_files = [path.as_posix() for path in paths if os.path.lexists(path)]
    if existing_files:
        raise ConfigError(f"files exist, and are never replaced: {', '.join(existing_files)}")


def _missing_toml(project: dict[str, Any], names: _Names, *, python: bool) -> str:
    """TOML to add to `pyproject.toml`: entry points, and the YAML in the package's wheel."""
    package = names.package
    if package in ("", "embodichain"):  # its tree is always searched
        return ""
    blocks = []
    groups = project.get("project", {}).get("entry-points", {})
    entry_points = [("embodichain.conf", package, f"{package}.conf")]
    if python:
        entry_points.append(("embodichain.tasks", names.task, names.module))
    for group, key, value in entry_points:
        if value not in groups.get(group, {}).values():
            table = f'project.entry-points."{group}"'
            blocks.append(_block(table, f'{key} = "{value}"', exists=group in groups))
    if not _puts_yaml_into_wheel(project, package):
        table = "tool.setuptools.package-data"
        exists = _package_data(project) is not None
        blocks.append(_block(table, f'{package} = ["conf/**/*.yaml"]', exists=exists))
    return "\n\n".join(blocks)


def _puts_yaml_into_wheel(project: dict[str, Any], package: str) -> bool:
    """Whether the package's wheel has its YAML: setuptools takes only Python files by default."""
    backend = str(project.get("build-system", {}).get("build-backend", "setuptools.build_meta"))
    if not backend.startswith("setuptools"):
        return True
    data = _package_data(project) or {}
    patterns = [
        *data.get(package, []),
        *(f"conf/{pattern}" for pattern in data.get(f"{package}.conf", [])),
        *(f"conf/{pattern}" for pattern in data.get("*", [])),
    ]
    return any(pattern.lstrip("/").startswith("conf/**/*.y") for pattern in patterns)


def _package_data(project: dict[str, Any]) -> dict[str, Any] | None:
    """The table of files that setuptools adds to packages."""
    return project.get("tool", {}).get("setuptools", {}).get("package-data")


def _block(table: str, line: str, *, exists: bool) -> str:
    """A line of a TOML table, with its header unless the file has the table already."""
    if exists:
        return f"# in [{table}], which exists:\n{line}"
    return f"[{table}]\n{line}"


def _next_commands(names: _Names) -> list[str]:
    """The commands to type next."""
    is_searched = names.conf == Path("conf") or names.package == "embodichain"
    config_dir = "" if is_searched else f" --config-dir {names.conf.as_posix()}"
    commands = [f"embodichain validate{config_dir} task={names.task}"]
    if importlib.util.find_spec("pytest") is None:
        commands.append("pip install pytest")
    return [
        *commands,
        f"python -m pytest {names.test.as_posix()}",
        f"embodichain run{config_dir} task={names.task}",
    ]
