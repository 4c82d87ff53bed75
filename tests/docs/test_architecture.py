"""The walk in docs/architecture.md is the way that the command takes."""

import re

import pytest

from tests.helpers.house import REPO, house

pytestmark = pytest.mark.slow

PAGE = (REPO / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_the_command_goes_through_the_files_of_the_walk() -> None:
    walk = PAGE.partition("## A walk")[2]
    named = re.findall(r"`([\w/]+\.py)`", walk)
    named.remove("recording/write/recorder.py")  # the walk has no log
    assert len(named) > 25
    opened = house().walk_command().files
    assert sorted(set(named) - opened.keys()) == []


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`([\w/]+/\w+\.py)`", PAGE))))
def test_files_that_are_named_exist(name: str) -> None:
    assert (REPO / name).is_file() or (REPO / "embodichain" / name).is_file()
