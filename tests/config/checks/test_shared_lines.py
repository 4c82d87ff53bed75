"""A mistake in an anchor is one mistake, however many keys read its line."""

from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.utils.errors import ConfigError, Problem, merged
from tests.config.conftest import WriteTask


def test_an_anchor_with_a_wrong_link(
    write_task: WriteTask, capsys: pytest.CaptureFixture[str]
) -> None:
    write_task("link_names: [ee_link]", "link_names: [ee_lnk]")
    assert main(["validate", "task=mine"]) == 2
    err = capsys.readouterr().err
    assert "mistakes" not in err
    assert err.count("no link of 'arm' matches 'ee_lnk'") == 1
    assert "conf/task/mine.yaml:" in err
    (path,) = Path("conf/task").glob("mine.yaml")
    line = 1 + path.read_text()[: path.read_text().index("ee_lnk")].count("\n")
    assert f"mine.yaml:{line}: task.rewards.near.params." in err
    assert "(task.metrics.success.params." in err
    assert "reads the same line)" in err


def test_what_is_merged() -> None:
    first = Problem("a.x", "wrong", "Did you mean 'y'?", source="file.yaml:3")
    same = Problem("b.x", "wrong", "Did you mean 'y'?", source="file.yaml:3")
    other_key = Problem("a.z", "wrong", "Did you mean 'y'?", source="file.yaml:3")
    other_text = Problem("b.x", "wrong, too", source="file.yaml:3")
    other_line = Problem("b.x", "wrong", "Did you mean 'y'?", source="file.yaml:4")
    typed = Problem("a.x", "wrong", source="command line")
    typed_too = Problem("b.x", "wrong", source="command line")
    problems = [first, same, other_key, other_text, other_line, typed, typed_too]
    assert [str(problem) for problem in merged(problems)] == [
        "file.yaml:3: a.x: wrong Did you mean 'y'? (b.x reads the same line)",
        "file.yaml:3: a.z: wrong Did you mean 'y'?",
        "file.yaml:3: b.x: wrong, too",
        "file.yaml:4: b.x: wrong Did you mean 'y'?",
        "command line: a.x: wrong",
        "command line: b.x: wrong",
    ]
    error = ConfigError(problems)
    assert len(error.problems) == 7  # each key has its own, for programs
    assert str(error).count("file.yaml:3") == 3
