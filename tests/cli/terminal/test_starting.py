"""Garbage waits for the first step, and never longer."""

import gc
from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.cli.terminal.process import end_startup, starting

pytestmark = pytest.mark.slow

seen: list[bool] = []


def look(obs, env):
    """A policy that looks whether garbage is collected."""
    seen.append(gc.isenabled())
    return env.last_action


def test_garbage_waits_until_started() -> None:
    with starting():
        assert not gc.isenabled()
        end_startup()
        assert gc.isenabled()
    assert gc.isenabled()


def test_a_failing_start_collects_again() -> None:
    with pytest.raises(ZeroDivisionError), starting():
        raise ZeroDivisionError
    assert gc.isenabled()


@pytest.mark.usefixtures("empty_cwd")
def test_garbage_is_collected_in_the_loop_and_after_mistakes() -> None:
    seen.clear()
    run = ("run", "task=random_reach", "max_steps=2", "record=none", "--quiet")
    assert main([*run, f"policy={__name__}:look"]) == 0
    assert seen == [True, True]
    assert main(["run", "task=nothing"]) == 2
    assert gc.isenabled()
    assert Path("outputs", "latest").exists()
