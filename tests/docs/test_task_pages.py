"""docs/tasks/: a page for each task that ships, as scripts/task_pages.py writes it."""

import re

import pytest
from PIL import Image

from embodichain.config import list_options
from scripts import task_pages
from scripts.task_pages import FILMS, FOLDER, SIZE, page

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

TASKS = list_options("task")


@pytest.mark.parametrize("task", ["reach", "push_cube", "hand_over", "quadruped_velocity"])
def test_a_page_is_what_the_script_writes(task: str) -> None:
    written = (FOLDER / f"{task}.md").read_text(encoding="utf-8")
    assert written == page(task), f"write it anew: python scripts/task_pages.py {task}"


def test_every_task_has_a_page_and_a_film() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.md")) == sorted(TASKS)
    assert sorted(path.stem for path in FILMS.glob("*.webp")) == sorted(TASKS)
    for task in TASKS:
        with Image.open(FILMS / f"{task}.webp") as film:
            assert film.size == SIZE
            is_solved = task_pages.film_policy(task) in ("pretrained", "expert")
            # WebP joins equal pictures: an arm that holds still has few.
            if is_solved:
                assert getattr(film, "n_frames", 1) > 5, task


def test_the_overview_links_every_page() -> None:
    overview = (FOLDER.parent / "tasks.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\]\(tasks/(\w+)\.md\)", overview)) == set(TASKS)


def test_pages_say_what_the_environment_has() -> None:
    """Numbers that were counted in conf/task/reach.yaml, not by the script."""
    text = page("reach")
    assert "| observation | 21 numbers |" in text  # 6 + 6 joints, 3 to the goal, 6 actions
    assert "| action | `Box(6,)`, each from -1 to 1 |" in text
    assert "| 12 to 14 | `to_goal` |" in text
    assert "truncated after 100 control steps (2 s)" in text
    assert "100.0% of 500 episodes [99.2%, 100.0%]" in text
