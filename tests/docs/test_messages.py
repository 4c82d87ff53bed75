"""docs/troubleshooting.md: each command says what the page says it does.

`...` stands for any text, so that lists that grow need no change.
"""

import re
import shlex
from pathlib import Path

import pytest

from embodichain.cli import main

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

PAGE = Path(__file__).parents[2] / "docs" / "troubleshooting.md"
EXAMPLE = re.compile(r"^```text\n\$ (embodichain .*)\n(error: (?:.|\n)*?)\n```$", re.MULTILINE)
EXAMPLES = EXAMPLE.findall(PAGE.read_text(encoding="utf-8"))


def test_the_page_has_messages() -> None:
    assert len(EXAMPLES) > 15


@pytest.mark.parametrize(("command", "message"), EXAMPLES, ids=[c for c, _ in EXAMPLES])
def test_a_command_says_what_the_page_says(
    command: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(shlex.split(command)[1:])
    errors = capsys.readouterr().err
    assert code == 2, errors
    parts = [re.escape(part) for part in message.replace("{...}", "{{}}").split("...")]
    pattern = ".*".join(parts).replace(re.escape("{{}}"), re.escape("{...}"))
    assert re.search(pattern, errors, re.DOTALL), errors
