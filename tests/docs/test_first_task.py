"""The task at the top of README.md and of the home page, with every robot that it names."""

import re
from pathlib import Path

import pytest

from embodichain.config import resolve

REPO = Path(__file__).parents[2]
BLOCK = re.compile(r"^<!-- conf/task/touch\.yaml -->\n```yaml\n(.*?)^```", re.MULTILINE | re.DOTALL)


def task_of(page: str) -> str:
    match = BLOCK.search((REPO / page).read_text(encoding="utf-8"))
    assert match is not None, page
    return match[1]


def test_both_pages_have_the_same_task() -> None:
    assert task_of("README.md") == task_of("docs/index.md")


@pytest.mark.parametrize("embodiment", ["ur10", "panda", "ur5e", "so101"])
def test_it_takes_the_robots_that_it_names(embodiment: str, tmp_path: Path) -> None:
    text = task_of("README.md")
    assert embodiment in text.splitlines()[0]
    (tmp_path / "task").mkdir()
    (tmp_path / "task" / "touch.yaml").write_text(text, encoding="utf-8")
    resolved = resolve(["task=touch", f"embodiment={embodiment}"], "train", tmp_path)
    assert resolved.tree["task"]["robot"]["uid"] == "robot"
    assert resolved.tree["total_timesteps"] == 300_000


def test_the_film_is_there() -> None:
    for page in ("README.md", "docs/index.md"):
        text = (REPO / page).read_text(encoding="utf-8")
        picture = re.search(r"^!\[[^]]+\]\(([^)]+)\)", text, re.MULTILINE)
        assert picture is not None
        file = REPO / Path(page).parent / picture[1]
        assert file.stat().st_size < 3_000_000
