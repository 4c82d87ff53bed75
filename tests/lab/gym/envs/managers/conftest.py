"""`make(**sections)`: environments of the test scene with the terms a test declares."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.helpers.ur10_task import builder


@pytest.fixture
def make() -> Iterator[Callable[..., Any]]:
    with builder() as build:
        yield build
