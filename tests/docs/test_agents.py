"""AGENTS.md and the skills: what they name exists, and every command in their blocks runs.

Commands run in a copy of the checkout, as its own tools would, and change nothing in this one.
Those of the Makefile (`mypy`, `lint-imports`) are left to `make check`, which runs them.
"""

import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

REPO = Path(__file__).parents[2]
SKILLS = sorted((REPO / ".claude" / "skills").glob("*/SKILL.md"))
PAGES = [REPO / "AGENTS.md", *SKILLS]
BLOCK = re.compile(r"^( *)```bash\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
SLOW = ("add-task-env", "pre-commit-check")


def named(page: Path) -> str:
    return page.stem if page.parent == REPO else page.parent.name


def commands(page: Path) -> list[str]:
    """The lines of the page's shell blocks that the Makefile does not run by itself."""
    text = page.read_text(encoding="utf-8")
    makefile = (REPO / "Makefile").read_text(encoding="utf-8").splitlines()
    blocks = (textwrap.dedent(body) for _, body in BLOCK.findall(text))
    lines = (line for block in blocks for line in block.splitlines() if line.strip())
    return [line for line in lines if f"\t$(BIN)/{line}" not in makefile]


# Commands that follow one another in one process: they import torch and MuJoCo once.
IN_ONE_PROCESS = """
import json, sys
import pytest
from embodichain.cli import main
for program, *words in json.loads(sys.argv[1]):
    code = main(words) if program == "embodichain" else pytest.main(words[2:])
    if code:
        sys.exit(f"{program} {words} failed")
"""


IMPORTING = re.compile(r"(embodichain|python -m pytest) [^<>|&;$]+")


def together(lines: list[str]) -> Iterator[list[str]]:
    """Commands for `subprocess`: neighbours that import torch become one, others are bash's."""
    for is_importing, group in itertools.groupby(
        lines, lambda line: bool(IMPORTING.fullmatch(line))
    ):
        if is_importing:
            words = [shlex.split(line, comments=True) for line in group]
            yield ["python", "-c", IN_ONE_PROCESS, json.dumps(words)]
        else:
            yield from (["bash", "-c", line] for line in group)


@pytest.fixture
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what is tracked, and of what will be.

    Each time at the same place, with the times of the files: Python compiles them once.
    """
    names = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"],
        cwd=REPO,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split("\0")
    copy = tmp_path_factory.getbasetemp() / "checkout"
    shutil.rmtree(copy, ignore_errors=True)
    for name in filter(None, names):
        source, target = REPO / name, copy / name
        if not source.exists():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target, follow_symlinks=False)
    return copy


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=named(page), marks=[pytest.mark.slow] if slow else [])
        for page in PAGES
        for slow in [page.parent.name in SLOW]
    ],
)
def test_commands_run(page: Path, checkout: Path) -> None:
    tools = Path(sys.executable).parent
    environment = {
        **os.environ,
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(checkout),
        "PYTEST_ADDOPTS": "-p no:cacheprovider",
    }
    lines = commands(page)
    assert lines
    for words in together(lines):
        done = subprocess.run(
            words,
            cwd=checkout,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{words[-1]}\n{done.stdout}{done.stderr}"


def test_there_are_three_skills_and_agents_md_names_them() -> None:
    assert [skill.parent.name for skill in SKILLS] == [
        "add-task-env",
        "add-test",
        "pre-commit-check",
    ]
    text = (REPO / "AGENTS.md").read_text(encoding="utf-8")
    for skill in SKILLS:
        assert f"]({skill.relative_to(REPO).as_posix()})" in text


@pytest.mark.parametrize("skill", SKILLS, ids=lambda skill: skill.parent.name)
def test_a_skill_says_its_name_and_when_to_use_it(skill: Path) -> None:
    _, head, body = skill.read_text(encoding="utf-8").split("---\n", 2)
    about = yaml.safe_load(head)
    assert set(about) == {"name", "description"}
    assert about["name"] == skill.parent.name
    assert "Use " in about["description"]
    assert body.lstrip().startswith("# ")
    assert len(body.splitlines()) < 60


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_files_and_targets_that_are_named_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    targets = re.findall(r"^([\w-]+):", (REPO / "Makefile").read_text(), re.MULTILINE)
    for target in re.findall(r"`make (\w+)`", text):
        assert target in targets, target
    for name in re.findall(r"`([\w./-]+/[\w./-]*|[A-Z]\w+\.md)`", text):
        if "KIND" in name or "my_task" in name or name == "SKILL.md":
            continue
        assert (REPO / name).exists() or (page.parent / name).exists(), name
