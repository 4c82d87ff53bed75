import io
import sys

import pytest

from embodichain.cli.terminal.reporting import ProgressDisplay


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def show(total: int | None, quiet: bool = False) -> None:
    with ProgressDisplay("reach", total, "episodes", quiet=quiet) as display:
        display.show(12, {"FPS": "1,234", "return": "-3.5"})


def test_a_line_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    show(1000)
    assert capsys.readouterr() == ("", "reach: 12/1,000 episodes  FPS 1,234  return -3.5\n")
    show(None)
    assert capsys.readouterr().err == "reach: 12 episodes  FPS 1,234  return -3.5\n"


def test_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    # pytest captures stderr into what is not a terminal.
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    show(40)
    text = screen.getvalue()
    assert "12/40 episodes FPS 1,234  return -3.5" in text
    assert "━" in text


def test_nothing_when_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    show(40, quiet=True)
    assert capsys.readouterr() == ("", "")


def test_due_is_a_matter_of_time() -> None:
    """A loop may ask in every step: without a terminal nothing is due for seconds."""
    with ProgressDisplay("reach", 1, "episodes") as display:
        assert not display.due
        # As when its seconds have passed.
        display._due = 0.0
        assert display.due
