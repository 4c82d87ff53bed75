import pytest

from embodichain.cli import process
from embodichain.cli.process import report
from embodichain.utils.errors import ConfigError, Problem, RenderError


def test_one_mistake_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert report(ConfigError([Problem("seed", "must be an integer", "Like 1")])) == 2
    assert capsys.readouterr().err == "error: seed: must be an integer Like 1\n"


def test_every_mistake_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert report(ConfigError([Problem("a", "one"), Problem("b", "two")])) == process.WRONG_INPUT
    assert capsys.readouterr().err == "2 mistakes:\n  a: one\n  b: two\n"


def test_other_exceptions_are_one_line_and_a_hint(capsys: pytest.CaptureFixture[str]) -> None:
    assert report(ValueError("three\nlines\nhere")) == process.FAILED
    text = capsys.readouterr().err
    assert text == "error: ValueError: three lines here\n(--traceback shows where it happened)\n"


def test_our_own_exceptions_say_enough_without_their_type(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert report(RenderError("no picture")) == process.WRONG_INPUT
    assert capsys.readouterr().err.startswith("error: no picture\n")


def test_the_whole_traceback_on_demand(capsys: pytest.CaptureFixture[str]) -> None:
    def fails() -> None:
        raise KeyError("gone")

    try:
        fails()
    except KeyError as error:
        assert report(error, full=True) == process.FAILED
    text = capsys.readouterr().err
    assert "in fails" in text
    assert "Traceback (most recent call last)" in text
    assert "--traceback" not in text


def test_interruption_has_its_own_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert report(KeyboardInterrupt()) == process.INTERRUPTED
    assert report(process.Interrupted("stopped; the log is complete")) == process.INTERRUPTED
    assert capsys.readouterr().err == "interrupted\nstopped; the log is complete\n"
