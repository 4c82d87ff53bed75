"""Runs the expert of every task with every embodiment that has what the task needs.

`python scripts/expert_table.py --write` plays 256 episodes of each, one process after another, and
writes the table of docs/tasks.md; without `--write` it prints it. `--tasks` and `--embodiments`
choose some: the other cells of the table stay as they are. An embodiment that lacks something is
left out; where a task is out of an embodiment's reach, its cell says ``cannot: ...``.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from embodichain.config import compose, list_options
from embodichain.config.checks.validation import check_composed

PAGE = Path(__file__).parents[1] / "docs" / "tasks.md"
BEGIN = "<!-- experts: python scripts/expert_table.py --write -->"
END = "<!-- end of experts -->"
Cells = dict[tuple[str, str], str]
"""(task, embodiment) -> what the table says."""


def main() -> None:
    """Run the experts and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=256)
    parser.add_argument("--num-envs", type=int, default=64)
    parser.add_argument("--tasks", nargs="+")
    parser.add_argument("--embodiments", nargs="+")
    parser.add_argument("--write", action="store_true", help="write the table into docs/tasks.md")
    options = parser.parse_args()
    cells = read_cells(PAGE.read_text(encoding="utf-8"))
    for task in options.tasks or tasks_with_experts():
        for embodiment in options.embodiments or embodiments_of(task):
            cells[task, embodiment] = success(
                task, embodiment, episodes=options.episodes, num_envs=options.num_envs
            )
            print(f"{task} {embodiment}: {cells[task, embodiment]}", file=sys.stderr, flush=True)
            if options.write:  # after each, so that nothing is lost
                write_cells(cells)
    if not options.write:
        print(table(cells))


def tasks_with_experts() -> list[str]:
    """Return the tasks that take an embodiment and have an expert; those with pictures do not."""
    tasks = []
    for task in list_options("task"):
        composed = compose([f"task={task}"])
        sensors = composed.tree["task"].get("sensors") or {}
        has_camera = any("camera" in str(sensor.get("sensor_type")) for sensor in sensors.values())
        has_place = "embodiment@task" in composed.choices
        if has_place and not has_camera and composed.tree["task"].get("expert"):
            tasks.append(task)
    return tasks


def embodiments_of(task: str) -> list[str]:
    """Return the embodiments that have what a task needs."""
    return [
        name
        for name in list_options("embodiment")
        if not check_composed(compose([f"task={task}", f"embodiment={name}"]), "run").problems
    ]


def success(task: str, embodiment: str, *, episodes: int, num_envs: int) -> str:
    """Return the share of episodes that succeed, as text; else why the run is refused."""
    count = min(num_envs, episodes)
    words = [f"task={task}", f"embodiment={embodiment}", "policy=expert", "seed=1", "record=none"]
    words += [f"num_envs={count}", f"episodes={episodes // count}", "scene_png=false", "--json"]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-m", "embodichain", "run", *words, "--quiet"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode != 0:
        print(done.stderr, file=sys.stderr)
        return why_not(done.stderr)
    return f"{100 * json.loads(done.stdout)['metrics']['success']:.1f} %"


def why_not(errors: str) -> str:
    """Return in a few words why a run was refused; ``-`` for a reason that is not the reach."""
    if "the tool cannot be there" in errors:
        return "cannot: its home is out of reach"
    if "reachable_by: cannot" in errors:
        return "cannot: too few places in reach"
    return "-"


def read_cells(page: str) -> Cells:
    """Return the cells of the table of a page."""
    cells: Cells = {}
    lines = page.partition(BEGIN)[2].partition(END)[0].strip().splitlines()
    if len(lines) < 3:
        return cells
    names = [word.strip(" `") for word in lines[0].strip("|").split("|")][1:]
    for line in lines[2:]:
        task, *values = (word.strip(" `") for word in line.strip("|").split("|"))
        cells |= {(task, name): value for name, value in zip(names, values, strict=True) if value}
    return cells


def table(cells: Mapping[tuple[str, str], str]) -> str:
    """Return the table as markdown: a row for each task, a column for each embodiment."""
    tasks = _distinct(task for task, _ in cells)
    names = _distinct(name for _, name in cells)
    lines = ["| task | " + " | ".join(f"`{name}`" for name in names) + " |"]
    lines.append("| --- |" + " --- |" * len(names))
    for task in tasks:
        values = " | ".join(cells.get((task, name), "") for name in names)
        lines.append(f"| `{task}` | {values} |")
    return "\n".join(lines)


def write_cells(cells: Mapping[tuple[str, str], str]) -> None:
    """Write the table between its marks in docs/tasks.md."""
    page = PAGE.read_text(encoding="utf-8")
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise SystemExit(f"{PAGE} has no marks {BEGIN} and {END}")
    PAGE.write_text(f"{before}{begin}\n{table(cells)}\n{end}{after}", encoding="utf-8")


def _distinct(names: Iterable[str]) -> list[str]:
    return sorted(set(names))


if __name__ == "__main__":
    main()
