"""Measured numbers have no exponent, whoever shows them."""

import re
from pathlib import Path

import numpy as np
import pytest

import embodichain
from embodichain.recording.views.channels import event_text
from embodichain.utils.number_text import result_number, signed_number

SOURCES = Path(embodichain.__file__).parent
SHOW_RESULTS = ("recording/viewers", "recording/views", "recording/export", "cli/pages")
"""Folders of what people look at."""
ALLOWED = {
    "axes.py": "ticks, with their own exponent",
    "runs_index.py": "numbers for a script",
    "lerobot_writer.py": "a rate, which may be any number",
    "web_process.py": "a speed that is chosen",
}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.0, "0"),
        (3e-24, "0"),
        (1.234e-5, "0.000012"),
        (-0.00051234, "-0.000512"),
        (0.123456, "0.1235"),
        (-2.5, "-2.5"),
        (1234.5678, "1,235"),
        (float("nan"), "nan"),
        (float("-inf"), "-inf"),
    ],
)
def test_a_number(value: float, text: str) -> None:
    assert result_number(value) == text
    assert signed_number(value) == (text if text.startswith("-") else f"+{text}")


def test_the_text_of_an_event() -> None:
    drawn = {"position": np.array([1.234e-5, 2.0, -12345.6])}
    said = event_text(3, "place", "reset", drawn)
    assert said == "environment 3: place (reset): position 0.000012 2 -12,346"


@pytest.mark.parametrize("folder", SHOW_RESULTS)
def test_nothing_that_people_look_at_formats_by_itself(folder: str) -> None:
    pattern = re.compile(r":\+?(\.\dg|g)\}")
    for path in (SOURCES / folder).rglob("*.py"):
        if path.name not in ALLOWED:
            assert not pattern.findall(path.read_text(encoding="utf-8")), path
