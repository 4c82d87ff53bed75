"""`new task`: what is written validates and passes its own tests, and nothing is overwritten."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from embodichain.cli import main

REPO = Path(__file__).parents[2]


def python(*arguments: str, cwd: Path | None = None) -> str:
    """Runs python without the working directory on its path, as the installed command does."""
    done = subprocess.run(
        [sys.executable, "-P", *arguments],
        cwd=cwd,
        env={**os.environ, "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def new(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, list[str]]:
    assert main(["new", "task", *arguments, "--json"]) == 0, capsys.readouterr().err
    data: dict[str, list[str]] = json.loads(capsys.readouterr().out)
    return data


def follow(commands: list[str]) -> str:
    """Does what `new` says comes next, the last with a short run; returns what pytest said."""
    said = ""
    for command in commands:
        program, *arguments = command.split()
        if program == "embodichain":
            short = ["max_steps=2", "record=none", "--quiet"] if arguments[0] == "run" else []
            python("-m", "embodichain", *arguments, *short)
        else:
            assert (program, arguments[:2]) == ("python", ["-m", "pytest"])
            said = python(*arguments, "-q", "-p", "no:cacheprovider")
    return said


def lint(*files: str) -> None:
    settings = ["--config", str(REPO / "pyproject.toml"), "--no-cache"]
    python("-m", "ruff", "check", *settings, *files)
    python("-m", "ruff", "format", "--check", *settings, *files)


def test_a_task_in_yaml_works_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    made = new(capsys, "my_reach")
    assert made["wrote"] == ["conf/task/my_reach.yaml", "tests/test_my_reach.py"]
    assert made["pyproject"] == ""
    assert "4 passed" in follow(made["next"])
    lint("tests/test_my_reach.py")


def test_a_task_in_python_works_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    made = new(capsys, "my_push", "--python")
    assert made["wrote"] == ["conf/task/my_push.yaml", "my_push.py", "tests/test_my_push.py"]
    assert "4 passed" in follow(made["next"])
    lint("my_push.py", "tests/test_my_push.py")
    code = "import sys; sys.path.append('.'); import gymnasium as gym; "
    code += "env = gym.make('my_push:MyPush-v0', num_envs=3); print(env.unwrapped.num_envs)"
    assert python("-c", code) == "3\n"


@pytest.mark.parametrize("source", [".", "src"])
def test_a_package_gets_both_inside_and_is_told_its_entry_points(
    source: str, capsys: pytest.CaptureFixture[str]
) -> None:
    project = '[project]\nname = "my-robots"\nversion = "1"\n'
    Path("pyproject.toml").write_text(project)
    package = Path(source, "my_robots")
    package.mkdir(parents=True)
    (package / "__init__.py").write_text('"""Mine."""\n')
    made = new(capsys, "stack", "--python")
    assert set(made["wrote"]) == {
        (package / "conf/__init__.py").as_posix(),
        (package / "conf/task/stack.yaml").as_posix(),
        (package / "tasks/__init__.py").as_posix(),
        (package / "tasks/stack.py").as_posix(),
        "tests/test_stack.py",
    }
    if source == "src":  # the harder one: nothing is installed
        assert "4 passed" in follow(made["next"])
    lint(source, "tests")
    assert Path("pyproject.toml").read_text() == project
    points = tomllib.loads(str(made["pyproject"]))["project"]["entry-points"]
    assert points == {
        "embodichain.conf": {"my_robots": "my_robots.conf"},
        "embodichain.tasks": {"stack": "my_robots.tasks.stack"},
    }
    Path("pyproject.toml").write_text(project + str(made["pyproject"]))
    again = new(capsys, "sort")
    assert again["pyproject"] == ""
    assert again["wrote"] == [(package / "conf/task/sort.yaml").as_posix(), "tests/test_sort.py"]


def test_nothing_is_overwritten(capsys: pytest.CaptureFixture[str]) -> None:
    Path("tests").mkdir()
    Path("tests/test_mine.py").write_text("# mine\n")
    assert main(["new", "task", "mine"]) == 2
    assert "exists already, and is not overwritten: tests/test_mine.py" in capsys.readouterr().err
    assert [str(path) for path in Path().rglob("*.*")] == ["tests/test_mine.py"]
    assert Path("tests/test_mine.py").read_text() == "# mine\n"
    Path("tests/test_mine.py").unlink()
    assert main(["new", "task", "mine"]) == 0
    before = Path("conf/task/mine.yaml").read_text()
    assert "next:\n  embodichain validate task=mine" in capsys.readouterr().out
    assert main(["new", "task", "mine", "--python"]) == 2
    assert Path("conf/task/mine.yaml").read_text() == before
    assert not Path("mine.py").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("task", "push-cube"), "'push-cube' is no name for a task"),
        (("task", "../reach2"), "is no name for a task"),
        (("task", "class"), "is no name for a task"),
        (("task", "2fast"), "is no name for a task"),
        (("task", "reach"), "there is a task 'reach' already"),
        (("task", "json", "--python"), "Python has a module 'json' already"),
        (("taks", "mine"), "Did you mean 'task'?"),
        (("task",), "NAME"),
        (("task", "mine", "--pyhton"), "Did you mean '--python'?"),
    ],
)
def test_what_cannot_be_made_is_refused(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", *arguments]) == 2
    assert words in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_a_broken_pyproject_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    Path("pyproject.toml").write_text("[project\n")
    assert main(["new", "task", "mine"]) == 2
    assert "pyproject.toml cannot be read" in capsys.readouterr().err
