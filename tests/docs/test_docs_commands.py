"""Every command in README.md and docs/ runs, in the order of its page, as it is written there.

Sweeps run in this process, but for the search of the page about sweeps: workers take seconds to
start. Runs draw their start, `scene.png`, on three pages: that takes longer than most of them.
A block below a comment that names a file, ``<!-- conf/task/mine.yaml -->``, is that file from there
on.
"""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from embodichain.cli import main
from tests.helpers.commands import Commands

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

REPO = Path(__file__).parents[2]
GYM_CONFIG = REPO / "tests" / "helpers" / "gym_configs" / "push.yaml"  # what commands call so
ELSEWHERE = ("make", "git clone", "pip")  # what sets a machine up: tests/packaging runs it
BLOCK = re.compile(
    r"^(?:<!-- (?P<file>[\w/.]+) -->\n)?```(?P<language>\w+)\n(?P<text>.*?)^```",
    re.MULTILINE | re.DOTALL,
)
SHELLS = ("bash", "sh", "shell")
DRAWN = ("README.md", "pictures.md", "reports.md")
"""Pages whose runs draw their start: the first, and those that are about pictures."""


def commands_in(text: str) -> list[str]:
    """The commands of shell blocks, continued lines joined."""
    lines = (line.strip() for line in text.replace("\\\n", " ").splitlines())
    return [line for line in lines if line and not line.startswith(("#", *ELSEWHERE))]


def steps(page: Path) -> list[tuple[str, str]]:
    """What a reader does, in order: a command ("", line), or writing a file (path, text)."""
    found: list[tuple[str, str]] = []
    for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
        if block["file"]:
            found.append((block["file"], block["text"]))
        elif block["language"] in SHELLS:
            found += [("", command) for command in commands_in(block["text"])]
    return found


PAGES = [
    page
    for page in (REPO / "README.md", *sorted((REPO / "docs").rglob("*.md")))
    if any(not path for path, _ in steps(page))
]


def run(
    command: str, commands: Commands, capsys: pytest.CaptureFixture[str], *, draws: bool
) -> None:
    program, *arguments = shlex.split(command, comments=True)
    assert program in ("embodichain", "python"), f"this test cannot run: {command}"
    if program == "embodichain":
        if arguments[0] == "run" and any(word.startswith("viewer=") for word in arguments):
            arguments.append("viewer.wait_s=0")  # nobody opens the page
        if arguments[0] == "run" and not draws and "scene_png=false" not in arguments:
            arguments.append("scene_png=false")
        assert main(arguments) == 0, f"{command}\n{capsys.readouterr().err}"
        return
    if arguments[:2] == ["-m", "pytest"]:
        done = commands.run(*arguments[2:], program="pytest", timeout=250)
    else:
        done = subprocess.run(
            [sys.executable, *arguments], capture_output=True, text=True, timeout=250, check=False
        )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"


def test_pages_have_commands() -> None:
    assert sum(len(steps(page)) for page in PAGES) > 15


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPO)))
def test_commands_run(page: Path, commands: Commands, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(GYM_CONFIG, "gym_config.yaml")
    for path, text in steps(page):
        if path:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            Path(path).write_text(text, encoding="utf-8")
        else:
            sweep = re.match("embodichain .* -m ", text) and "hydra/sweeper=optuna" not in text
            command = f"{text} hydra/launcher=basic" if sweep else text
            run(command, commands, capsys, draws=page.name in DRAWN)
