"""Every command in README.md and docs/ runs, in the order of its page, as it is written there."""

import re
import shlex
import shutil
from pathlib import Path

import pytest

from embodichain.cli import main

REPO = Path(__file__).parents[2]
GYM_CONFIG = REPO / "tests" / "helpers" / "gym_configs" / "push.yaml"  # what commands call so
ELSEWHERE = ("make", "git clone", "pip")  # what sets a machine up: tests/packaging runs it
BLOCK = re.compile(r"^```(?:bash|sh|shell)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def commands(page: Path) -> list[str]:
    """The commands of a page's shell blocks, continued lines joined."""
    text = "\n".join(BLOCK.findall(page.read_text(encoding="utf-8"))).replace("\\\n", " ")
    lines = (line.strip() for line in text.splitlines())
    return [line for line in lines if line and not line.startswith(("#", *ELSEWHERE))]


PAGES = [REPO / "README.md", *sorted((REPO / "docs").glob("*.md"))]


def test_pages_have_commands() -> None:
    assert sum(len(commands(page)) for page in PAGES) > 15


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=lambda page: page.name)
def test_commands_run(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(GYM_CONFIG, "gym_config.yaml")
    for command in commands(page):
        program, *arguments = shlex.split(command, comments=True)
        assert program == "embodichain", f"{page.name}: this test cannot run: {command}"
        code = main(arguments)
        assert code == 0, f"{page.name}: {command}\n{capsys.readouterr().err}"
