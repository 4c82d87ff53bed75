"""Tests marked `unmeasured` run without coverage; those after them are measured again."""

import os
import sys

import pytest


@pytest.fixture
def measured() -> bool:
    """Whether processes that this test starts are measured."""
    return "COVERAGE_PROCESS_CONFIG" in os.environ


@pytest.mark.unmeasured
def test_a_marked_test_and_its_processes_are_not_measured(measured: bool) -> None:
    assert sys.gettrace() is None
    assert not measured


def test_the_next_test_is_measured_in_both_threads(measured: bool) -> None:
    from embodichain.lab.sim.drawing.thread import render_thread

    assert (sys.gettrace() is not None) == measured
    assert (render_thread().call(sys.gettrace) is not None) == measured
