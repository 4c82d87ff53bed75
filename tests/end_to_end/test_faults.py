"""Calls on files that fail one after another, in each verb: nothing half-written, nothing silent.

A sample; `scripts/fail_every_call.py` tries all of them.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.faults import CASES, Forks, build, sampled, tried

SAMPLES = {"run": 6, "train": 6, "collect": 5, "report": 4, "recover": 4}
"""Calls of a verb that fail; each is a command, and one more to see that it can be repeated."""
OF_EXPORT = 2
"""Calls of an export, in a format."""

pytestmark = pytest.mark.unmeasured


@pytest.fixture(scope="module")
def forks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forks]:
    library = build(tmp_path_factory.mktemp("library"))
    if library is None:
        pytest.skip("there is no gcc, which builds what makes calls fail")
    with Forks(library) as made:
        yield made


@pytest.mark.parametrize("name", CASES)
def test_after_a_call_that_fails_all_is_as_promised(
    name: str, forks: Forks, tmp_path: Path
) -> None:
    count, found = tried(CASES[name], forks, tmp_path, SAMPLES.get(name, OF_EXPORT))
    assert count > 3  # the library sees the calls
    wrong = {f"{r.n} ({r.ended.failed})": (r.wrong, r.ended.err) for r in found if r.wrong}
    assert not wrong
    assert sum(bool(result.ended.failed) for result in found) >= len(found) - 1


def test_what_is_sampled_has_the_first_call_and_the_last() -> None:
    assert sampled(3, 5) == [1, 2, 3]
    assert sampled(101, 5) == [1, 26, 51, 76, 101]
