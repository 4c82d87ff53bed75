"""Tables in pipes and files: 100 columns, and nothing that is looked for is cut."""

import pytest

from embodichain.cli import main
from embodichain.cli.terminal.output import print_facts, print_table

PATH = "outputs/2026-01-01/" + "a-long-name/" * 10 + "rollout.mcap"
TEXT = "words " * 60


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)


def test_text_is_folded_and_names_are_whole(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("table", [{"name": "a" * 40, "what": TEXT, "number": 1.5}])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 101
    assert any("a" * 40 in line for line in lines)
    assert " ".join(lines).count("words") == 60


def test_a_path_is_never_cut(capsys: pytest.CaptureFixture[str]) -> None:
    print_facts("facts", [("text", TEXT), ("folder", PATH)])
    print_table("table", [{"folder": PATH, "what": TEXT}])
    out = capsys.readouterr().out
    assert out.count(PATH) == 2


def test_every_list_fits(capsys: pytest.CaptureFixture[str]) -> None:
    for what in ("tasks", "robots", "terms"):
        assert main(["list", what]) == 0
        assert max(map(len, capsys.readouterr().out.splitlines())) <= 101


def test_an_unknown_term_is_answered_in_one_readable_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    keys = ["task=reach", "task.rewards.near.func=distance_tahn"]
    assert main(["validate", *keys]) == 2
    line = next(x for x in capsys.readouterr().err.splitlines() if "distance_tahn" in x)
    assert "unknown reward term 'distance_tahn'; allowed: distance_tanh, " in line
    assert "in all: `embodichain list terms`)" in line
    assert line.count(",") < 10
