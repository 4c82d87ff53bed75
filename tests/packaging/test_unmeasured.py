"""Tests marked `unmeasured` run without coverage; those after them are measured again."""

import os
import sys

import pytest

pytestmark = pytest.mark.skipif(
    "COVERAGE_PROCESS_CONFIG" not in os.environ, reason="of `make coverage`"
)


@pytest.mark.unmeasured
def test_a_marked_test_and_its_processes_are_not_measured() -> None:
    assert sys.gettrace() is None
    assert "COVERAGE_PROCESS_CONFIG" not in os.environ


def test_the_next_test_is_measured_in_both_threads_and_its_processes() -> None:
    from embodichain.lab.sim.drawing.thread import render_thread

    assert sys.gettrace() is not None
    assert render_thread().call(sys.gettrace) is not None
    assert "COVERAGE_PROCESS_CONFIG" in os.environ
