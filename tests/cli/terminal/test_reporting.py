import errno
import os
import threading
from pathlib import Path

import pytest

from embodichain.cli.terminal import process
from embodichain.cli.terminal.process import report
from embodichain.cli.terminal.reporting import log_to
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


def test_an_error_of_the_system_is_its_reason_and_its_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    error = OSError(errno.ENOSPC, "No space left on device", "a/b.csv")
    assert report(error) == process.FAILED
    assert capsys.readouterr().err == "error: No space left on device: a/b.csv\n"


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (errno.EIO, process.FAILED),
        (errno.ENOSPC, process.FAILED),
        (errno.EMFILE, process.FAILED),
        (errno.ENOENT, process.WRONG_INPUT),
        (errno.EACCES, process.WRONG_INPUT),
    ],
)
def test_a_machine_that_fails_is_no_wrong_input(
    number: int, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    error = ConfigError(f"cannot read a.yaml: {os.strerror(number)}")
    error.__cause__ = OSError(number, os.strerror(number), "a.yaml")
    assert report(error) == code
    assert capsys.readouterr().err == f"error: cannot read a.yaml: {os.strerror(number)}\n"


def test_a_thread_that_fails_is_one_line_and_its_traceback_is_in_the_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    before = threading.excepthook
    with log_to(tmp_path / "run.log"):
        thread = threading.Thread(target=fail, name="events")
        thread.start()
        thread.join()
    assert threading.excepthook is before
    said = "thread events ended: OSError: [Errno 5] Input/output error"
    assert capsys.readouterr().err == f"warning: {said}\n"
    text = (tmp_path / "run.log").read_text()
    assert said in text and "in fail" in text
