"""Tables of docs/settings.md and docs/success.md agree with the tasks and with the statistics."""

import re
from pathlib import Path

import pytest

from embodichain.config import compose
from embodichain.learning.evaluation.statistics import rate

DOCS = Path(__file__).parents[2] / "docs"


def rows(page: str, mark: str) -> list[list[str]]:
    text = (DOCS / page).read_text(encoding="utf-8")
    table = text.partition(f"<!-- {mark} -->")[2].partition(f"<!-- end of {mark} -->")[0]
    lines = table.strip().splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


@pytest.mark.parametrize("row", rows("settings.md", "settings"), ids=lambda row: row[1])
def test_values_to_start_from_are_those_of_the_task(row: list[str]) -> None:
    suggested = compose([f"task={row[1].strip('`')}"]).tree["task"]["suggested"]["train"]
    algo = suggested["algo"]
    expected = [
        suggested["num_envs"],
        suggested["total_timesteps"],
        algo["learning_rate"],
        algo.get("gamma"),
        algo["n_steps"],
        algo["batch_size"],
        algo["n_epochs"],
        algo["policy_kwargs"].get("log_std_init") if "policy_kwargs" in algo else None,
        algo.get("normalize"),
    ]
    for cell, value in zip(row[2:], expected, strict=True):
        if value is None:
            assert cell == ""
        elif isinstance(value, str):
            assert cell == value
        else:
            assert float(cell.replace(",", "")) == pytest.approx(value)


def test_the_table_of_intervals_is_computed() -> None:
    table = rows("success.md", "wilson")
    assert len(table) == 3
    for first, *cells in table:
        share = float(first.rstrip(" %")) / 100
        for count, cell in zip((16, 100, 500), cells, strict=True):
            successes = round(share * count)
            measured = rate([True] * successes + [False] * (count - successes))
            assert measured is not None
            low, high = (100 * end for end in measured.interval)
            assert cell == f"{low:.1f} % to {high:.1f} %"


def test_every_question_is_two_clicks_from_home() -> None:
    """Home has a link to the page of questions, and that to every answer."""
    home = (DOCS / "index.md").read_text(encoding="utf-8")
    assert "](faq.md)" in home
    questions = (DOCS / "faq.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| ([^|]*\?) \| (.*) \|$", questions, re.MULTILINE)
    assert len(table) >= 20
    for question, answer in table:
        assert re.search(r"\]\([\w/.#-]+\)", answer), question
