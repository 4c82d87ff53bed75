import io
import re
import sys

import pytest

from embodichain.cli.jobs.work.dashboard import Dashboard
from embodichain.learning.evaluation.episodes import TrainStatistics


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def statistics() -> TrainStatistics:
    """A training at half of its steps, a minute old."""
    found = TrainStatistics(40_000)
    found.load_state_dict({**found.state_dict(), "seconds": 60})
    found.begin()
    found.end()
    found.env_steps = 20_000
    found.fractions = {"physics": 0.4, "environment": 0.2, "policy": 0.1, "update": 0.3}
    for i in range(4):
        found.add({"episode": {"r": -2.5, "l": 90}, "is_success": i < 3})
    found.best = (10_000, (0.5, -4.0))
    return found


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    found = Terminal()
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    return found


def dashboard(screen: Terminal, monkeypatch: pytest.MonkeyPatch, quiet: bool = False) -> Dashboard:
    monkeypatch.setattr(sys, "stderr", screen)  # here: pytest sets its own before each test
    return Dashboard("reach", "ppo", 40_000, quiet=quiet)


def lines(screen: Terminal) -> dict[str, list[str]]:
    """What is on the screen now: the cells of each row by its first."""
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue()).replace("\r", "\n")
    rows = [re.split(r" {2,}", line.strip()) for line in text.splitlines() if line.strip()]
    return {row[0]: row[1:] for row in rows}


def test_everything_is_on_the_screen(
    screen: Terminal, monkeypatch: pytest.MonkeyPatch, statistics: TrainStatistics
) -> None:
    with dashboard(screen, monkeypatch) as display:
        display.update(statistics)
        shown = lines(screen)
    assert shown["reach, ppo"][-1] == "20,000/40,000 steps" and "━" in shown["reach, ppo"][0]
    assert shown["speed"] == ["333 steps/s", "█" * 30]
    parts = ["physics 40%", "environment 20%", "policy 10%", "update 30%"]
    assert shown["time"] == ["1:00, left 1:00", *parts]  # at the bottom of 80 columns, all of it
    assert shown["return"][0] == "-2.5"
    assert shown["success"][0] == "75%"
    assert shown["length"][0] == "90"
    assert shown["best"] == ["success 50%", "at 10,000 steps"]
    assert shown["episodes"] == ["4"]


def test_curves_grow_with_the_steps(
    screen: Terminal, monkeypatch: pytest.MonkeyPatch, statistics: TrainStatistics
) -> None:
    with dashboard(screen, monkeypatch) as display:
        for steps, successes in ((0, 0), (20_000, 1), (40_000, 1)):
            statistics.env_steps = steps
            # The rate is of the last 100 episodes: one alone lets it jump.
            statistics._successes.clear()
            statistics._successes.append(bool(successes))
            display.update(statistics)
    curve = lines(screen)["success"][1]
    assert curve == "▁" * 15 + "█" * 15


def test_nothing_has_ended_yet(screen: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    with dashboard(screen, monkeypatch) as display:
        display.update(TrainStatistics(40_000))
    shown = lines(screen)
    assert shown["return"] == shown["success"] == shown["best"] == ["-"]


def test_the_last_state_stays(
    screen: Terminal, monkeypatch: pytest.MonkeyPatch, statistics: TrainStatistics
) -> None:
    with dashboard(screen, monkeypatch) as display:
        display.update(statistics)
        assert not display.due  # for a second
        statistics.env_steps = 40_000
    assert lines(screen)["reach, ppo"][-1] == "40,000/40,000 steps"


def test_a_line_now_and_then_without_a_terminal(
    capsys: pytest.CaptureFixture[str], statistics: TrainStatistics
) -> None:
    with Dashboard("reach", "ppo", 40_000) as display:
        assert not display.due
        display.update(statistics)
    expected = "reach: 20,000/40,000 steps  steps/s 333  episodes 4  return -2.5  success 75%\n"
    assert capsys.readouterr() == ("", expected)


def test_nothing_when_quiet(
    screen: Terminal, monkeypatch: pytest.MonkeyPatch, statistics: TrainStatistics
) -> None:
    with dashboard(screen, monkeypatch, quiet=True) as display:
        display.update(statistics)
        assert not display.due
    assert screen.getvalue() == ""
