"""Calls on files that fail one after another, in each verb: nothing half-written, nothing silent.

A sample; `scripts/fail_every_call.py` tries all of them.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from tests.helpers.faults import CASES, sampled, tried
from tests.helpers.forks import Forks, verb_forks

CALLS = 12
"""Calls of a verb that fail; each is a command, and for each second one more, which repeats it."""
FEW = 3
"""Calls of an export, in each of seven formats, and of a run with a picture."""

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]


@pytest.fixture(scope="module")
def forks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forks]:
    try:
        with verb_forks(tmp_path_factory.mktemp("library")) as made:
            yield made
    except FileNotFoundError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("name", CASES)
def test_after_a_call_that_fails_all_is_as_promised(
    name: str, forks: Forks, tmp_path: Path
) -> None:
    most = FEW if name.startswith("export") or name == "run-picture" else CALLS
    chosen = partial(_evenly, most)
    calls, found = tried(CASES[name], forks, tmp_path, chosen, again_every=2)
    assert len(calls) > 3  # the library sees the calls
    wrong = {f"{r.n} ({r.ended.failed})": (r.wrong, r.ended.err) for r in found if r.wrong}
    assert not wrong
    assert sum(bool(result.ended.failed) for result in found) >= len(found) - 1


@pytest.mark.parametrize("name", [name for name in CASES if name.startswith("export")])
def test_a_file_that_cannot_be_closed_is_an_error_with_its_reason(
    name: str, forks: Forks, tmp_path: Path
) -> None:
    _, found = tried(CASES[name], forks, tmp_path, _closing, again_every=100)
    assert found
    assert [(r.n, r.wrong, r.ended.err) for r in found if r.wrong] == []


def _evenly(most: int, calls: list[str]) -> list[int]:
    return sampled(len(calls), most)


def _closing(calls: list[str]) -> list[int]:
    return [n for n, call in enumerate(calls, start=1) if call.startswith("close ")]


def test_what_is_sampled_has_the_first_call_and_the_last() -> None:
    assert sampled(3, 5) == [1, 2, 3]
    assert sampled(101, 5) == [1, 26, 51, 76, 101]
