"""The workflow files: YAML whose commands are the Makefile's and which name existing files.

No runner is at hand; what can be checked without one is checked here.
"""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

FILES = {"ci.yml": {"push", "pull_request"}, "release.yml": {"push"}}
MATRIX = re.compile(r"\$\{\{ matrix\.(\w+) \}\}")


@pytest.fixture(params=FILES)
def workflow(request: pytest.FixtureRequest, repo: Path) -> dict[str, Any]:
    name = str(request.param)
    text = (repo / ".github" / "workflows" / name).read_text(encoding="utf-8")
    found = yaml.load(text, yaml.BaseLoader)  # in which `on` is a word
    assert set(found["on"]) == FILES[name]
    return dict(found)


def runs(workflow: dict[str, Any]) -> list[str]:
    """Every command, one for each value of a matrix."""
    found = []
    for job in workflow["jobs"].values():
        matrix = job.get("strategy", {}).get("matrix", {})
        for step in job["steps"]:
            command = step.get("run", "")
            values = matrix[match[1]] if (match := MATRIX.search(command)) else [""]
            found += [MATRIX.sub(value, command) for value in values]
    return [command for command in found if command]


def test_commands_are_the_makefiles(workflow: dict[str, Any], repo: Path) -> None:
    targets = re.findall(r"^([\w-]+):", (repo / "Makefile").read_text(), re.MULTILINE)
    commands = runs(workflow)
    assert sum(command.startswith("make ") for command in commands) >= 2
    for command in commands:
        assert "\n" not in command  # a script belongs to the Makefile or scripts/
        program, target, *_ = command.removeprefix("sudo ").split()
        if program == "make":
            assert target in targets
        elif program == "sh":
            assert (repo / target).is_file()
        else:
            assert program in ("docker", "gh")


def test_actions_have_a_version_and_jobs_a_limit(workflow: dict[str, Any]) -> None:
    for job in workflow["jobs"].values():
        assert int(job["timeout-minutes"]) <= 90
        uses = [step["uses"] for step in job["steps"] if "uses" in step]
        assert uses
        assert all(re.fullmatch(r"actions/[\w-]+@v\d+", action) for action in uses)


def test_tokens_may_only_read_unless_a_release_is_written(workflow: dict[str, Any]) -> None:
    assert workflow["permissions"] == {"contents": "read"}
    writing = [name for name, job in workflow["jobs"].items() if "permissions" in job]
    assert writing == (["build"] if workflow["name"] == "release" else [])


def test_every_interpreter_of_the_smoke_test_is_set_up(repo: Path) -> None:
    from scripts.smoke import VERSIONS

    folder = repo / ".github" / "workflows"
    ci = yaml.safe_load((folder / "ci.yml").read_text())
    assert tuple(ci["jobs"]["check"]["strategy"]["matrix"]["python"]) == VERSIONS
    release = (folder / "release.yml").read_text()
    assert all(f"            {version}\n" in release for version in VERSIONS)
