"""Write a page for each task that ships, docs/tasks/NAME.md, and its film.

`python scripts/task_pages.py` writes all pages, `python scripts/task_pages.py reach` one; with
`--films` also docs/images/tasks/NAME.webp: the policy that `embodichain demo` shows, or a still
picture of a task that nothing solves yet. A page has what the built environment has: columns of
actions and observations, rewards, terminations, and who solves the task how often.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

from embodichain.cli.jobs.job import policy_of
from embodichain.cli.results.show_task import task_tables
from embodichain.cli.results.terms import find_entries
from embodichain.config import compose, list_options
from embodichain.config.environments.factory import make_env
from embodichain.config.resolved import resolve
from embodichain.data.pretrained import pretrained, pretrained_tasks
from embodichain.learning.evaluation.statistics import rate
from scripts import expert_table

REPO = Path(__file__).parents[1]
FOLDER = REPO / "docs" / "tasks"
FILMS = REPO / "docs" / "images" / "tasks"
SIZE = 400, 300
"""Width and height of a film in pixels."""
RATE = 12.5
"""Pictures of a film per second of simulated time, at most."""
MAX_SECONDS = 6.0
QUALITY = 45
"""Of WebP, up to 100."""
EXPERT_EPISODES = 256
"""Episodes behind each cell of the table that scripts/expert_table.py makes."""
MANY_NAMES = 7
"""More joints than these are named by the first and the last."""
ALIAS = re.compile(r"^Alias of (`+).*?\1\. ")
SHAPE = re.compile(r"^\([^)]*\) (\w)")
"""What summaries of terms begin with: ``(N, 3) position of ...``."""
ROBOT_PACKAGE = ("panda", "go1", "go2", "g1")
"""Embodiments whose robot is in the package example-robot-data."""


@dataclass(frozen=True)
class Solution:
    """Who solves a task, and how often.

    Attributes:
        who: A policy, an expert or a training.
        count: Episodes that succeeded; None if it was not measured.
        episodes: Episodes that were played.
        command: What plays or trains it.
    """

    who: str
    count: int | None
    episodes: int
    command: str

    def row(self) -> list[str]:
        """Cells of the table: who, success with its interval, command."""
        success = "not measured"
        if self.count is not None:
            episodes = [True] * self.count + [False] * (self.episodes - self.count)
            low, high = rate(episodes).interval
            success = (
                f"{self.count / self.episodes:.1%} of {self.episodes} episodes "
                f"[{low:.1%}, {high:.1%}]"
            )
        return [self.who, success, f"`{self.command}`"]


TRAINED = {
    "lift_cube": Solution(
        "[PPO](../results/training.md#a-cube-is-lifted), 10 million steps, with version 0.1.0",
        99,
        100,
        "embodichain train task=lift_cube seed=2",
    ),
    "quadruped_rough": Solution(
        "[PPO](../results/training.md#a-quadruped-walks-over-rough-ground), 10 million steps, on "
        "the two easiest levels, with version 0.1.0",
        98,
        100,
        "embodichain train task=quadruped_rough seed=1",
    ),
    "humanoid_velocity": Solution(
        "[PPO](../results/training.md#a-humanoid-walks), 12 million steps, with version 0.1.0",
        441,
        500,
        "embodichain train task=humanoid_velocity seed=1",
    ),
    "reach_vision": Solution(
        "[PPO](../results/images.md) from pictures, 400,000 steps",
        188,
        200,
        "embodichain train task=reach_vision seed=1 eval.episodes=200",
    ),
}
"""Trainings whose policy does not ship; the pages of results say how they were measured."""
WITHOUT_SUCCESS = {"random_reach": "random", "hold_still": "hold"}
"""Task -> policy of its film, of tasks that nobody has to solve."""


def page(task: str) -> str:
    """Return a task's page as markdown.

    Raises:
        ConfigError: If there is no such task, or its robot is not installed.
    """
    resolved = resolve([f"task={task}", "seed=1"], "run")
    tables = task_tables(resolved)
    cfg = resolved.tree["task"]
    film = f"images/tasks/{task}.webp"
    lines = [
        f"<!-- python scripts/task_pages.py {task} -->",
        f"# {task}",
        "",
        cfg["description"],
        "",
        f"![{_alt_text(task)}](../{film})",
        "",
        *_commands(task, cfg),
        *_facts(task, tables),
        *_actions(tables),
        *_observations(tables),
        *_terms(
            "Rewards",
            "reward",
            tables["rewards"],
            ("weight", "shape", "params"),
            "The sum is the reward of a control step.",
        ),
        *_terms(
            "Terminations",
            "termination",
            tables["terminations"],
            ("kind", "shape", "params"),
            _limit(tables["timing"]["episode"]),
        ),
        *_terms("Commands", "command", tables["commands"], ("params",)),
        *_terms("Events", "event", tables["events"], ("mode", "params")),
        *_terms(
            "Success and metrics",
            "metric",
            tables["metrics"],
            ("shape", "reduce", "params"),
            "`reduce` says which of an episode's steps count.",
        ),
        *_solutions(task, cfg),
        *_training(tables["training"]),
    ]
    return "\n".join(lines).rstrip() + "\n"


def solutions(task: str, cfg: Mapping[str, Any]) -> list[Solution]:
    """Return who solves a task: the policy that ships, the expert, a measured training."""
    answers = []
    if task in pretrained_tasks():
        policy = pretrained(task)
        answers.append(
            Solution(
                f"the [policy that ships](../policies.md#policies-that-ship), trained for "
                f"{policy.env_steps:,} steps",
                round(policy.success * policy.episodes),
                policy.episodes,
                f"embodichain eval pretrained task={task}",
            )
        )
    if cfg.get("expert"):
        embodiment = compose([f"task={task}"]).choices.get("embodiment@task")
        cells = expert_table.read_cells(expert_table.PAGE.read_text(encoding="utf-8"))
        percent = cells.get((task, str(embodiment)), "")
        count = None
        if percent.endswith("%"):
            count = round(float(percent.rstrip(" %")) / 100 * EXPERT_EPISODES)
        answers.append(
            Solution(
                "its [expert](../manipulation.md#experts)",
                count,
                EXPERT_EPISODES,
                f"embodichain run task={task} policy=expert seed=1 num_envs=64 episodes=4",
            )
        )
    if task in TRAINED:
        answers.append(TRAINED[task])
    return answers


def film(task: str) -> None:
    """Write a task's film, or its picture if nothing solves it."""
    policy = film_policy(task)
    words = [f"task={task}", "seed=1", "num_envs=1", f"policy={policy or 'zero'}", "record=none"]
    resolved = resolve(words, "run")
    env = make_env(resolved)
    try:
        act = policy_of(resolved.root, env)
        obs, _ = env.reset()
        pictures = [_picture(env)]
        every = max(1, round(1 / RATE / env.step_dt))
        steps = round(MAX_SECONDS / env.step_dt) if policy else 0
        has_several_episodes = 2 * env.max_episode_steps <= steps
        for step in range(1, steps + 1):
            obs, _, terminated, truncated, _ = env.step(act(obs, env))
            if bool(terminated[0]) or bool(truncated[0]):
                if not has_several_episodes:
                    break
                act.reset(np.array([0]))
            if step % every == 0:
                pictures.append(_picture(env))
        seconds = every * env.step_dt
    finally:
        env.close()
    FILMS.mkdir(parents=True, exist_ok=True)
    durations = [round(1000 * seconds)] * len(pictures)
    durations[-1] = 1000  # the end is seen before it starts again
    pictures[0].save(
        FILMS / f"{task}.webp",
        save_all=True,
        append_images=pictures[1:],
        duration=durations,
        loop=0,
        quality=QUALITY,
        method=4,
    )


def film_policy(task: str) -> str | None:
    """Return the policy that solves a task in its film; None if there is none."""
    if task in WITHOUT_SUCCESS:
        return WITHOUT_SUCCESS[task]
    if task in pretrained_tasks():
        return "pretrained"
    has_expert = compose([f"task={task}"]).tree["task"].get("expert")
    return "expert" if has_expert else None


def _picture(env: Any) -> Image.Image:
    return Image.fromarray(env.sim.render(0, "default", *SIZE))


def _alt_text(task: str) -> str:
    policy = film_policy(task)
    if policy is None:
        return f"A picture of {task}"
    names = {"pretrained": "the policy that ships", "expert": "its expert"}
    return f"{task}, played by {names.get(policy, f'the policy {policy}')}"


def _commands(task: str, cfg: Mapping[str, Any]) -> Iterator[str]:
    """The commands that show, run and train the task."""
    yield "```text"
    if task in pretrained_tasks() or cfg.get("expert"):
        yield f"embodichain demo {task}"
    policy = f" policy={WITHOUT_SUCCESS[task]}" if task in WITHOUT_SUCCESS else ""
    yield f"embodichain run task={task} num_envs=4{policy}"
    if (cfg.get("suggested") or {}).get("train"):
        yield f"embodichain train task={task}"
    yield "```"
    yield ""


def _facts(task: str, tables: Mapping[str, Any]) -> Iterator[str]:
    embodiment = compose([f"task={task}"]).choices.get("embodiment@task")
    timing = tables["timing"]
    action = next(row for row in tables["spaces"] if row["space"] == "action")
    columns = [row for row in _columns(tables) if row["group"] == "policy"]
    yield "| | |"
    yield "| --- | --- |"
    if embodiment:
        extra = ", from `pip install 'embodichain[robots]'`" if embodiment in ROBOT_PACKAGE else ""
        link = "[another one](../composition.md#embodiments) with `embodiment=NAME`"
        yield f"| robot | `{embodiment}`{extra}; {link} |"
    yield f"| action | `Box{action['shape']}`, {_bounds(action)} |"
    images = [row for row in tables["observations"] if _is_image(row)]
    width = _width(columns)
    parts = [f"{width} numbers"] if width else []
    parts += [f"`{row['term']}` {row['shape']}" for row in images if row["group"] == "policy"]
    yield f"| observation | {', '.join(parts)} |"
    yield f"| control step | {timing['control step']}, a physics step is {timing['physics step']} |"
    yield f"| episode | {timing['episode']} |"
    yield f'| Python | `embodichain.make("{task}", num_envs=64)` |'
    yield f'| Gymnasium | `gymnasium.make_vec("embodichain/{task}-v0", num_envs=64)` |'
    yield f"| file | [conf/task/{task}.yaml](../../conf/task/{task}.yaml) |"
    yield ""


def _actions(tables: Mapping[str, Any]) -> Iterator[str]:
    yield "## Actions"
    yield ""
    rows = tables["actions"]
    yield from _table(
        ["action", "term", "numbers", "what"],
        [
            [
                f"`{row['term']}`",
                _term_link(row["func"]),
                row["shape"].strip("(,)"),
                _summary(row["func"], "action"),
            ]
            for row in rows
        ],
    )
    columns = [_without_none(row) for row in tables["action vector"]]
    names = list(dict.fromkeys(name for row in columns for name in row))
    yield from _table(names, [[_cell(row.get(name)) for name in names] for row in columns])


def _observations(tables: Mapping[str, Any]) -> Iterator[str]:
    yield "## Observations"
    yield ""
    what = {row.get("name") or row["term"]: row["func"] for row in tables["observations"]}
    groups = dict.fromkeys(row["group"] for row in _columns(tables))
    for group in groups:
        rows = [row for row in _columns(tables) if row["group"] == group]
        if len(groups) > 1:
            yield f"Group `{group}`:"
            yield ""
        merged = _merge_columns(rows)
        yield from _table(
            ["columns", "observation", "of", "scale", "what"],
            [
                [
                    row["columns"],
                    f"`{row['term']}`",
                    row["of"],
                    _cell(row["scale"]),
                    _described(what[row["term"]], "observation"),
                ]
                for row in merged
            ],
        )
    images = [row for row in tables["observations"] if _is_image(row)]
    if images:
        yield "Images:"
        yield ""
        yield from _table(
            ["observation", "group", "shape", "what"],
            [
                [
                    f"`{r['term']}`",
                    f"`{r['group']}`",
                    r["shape"],
                    _described(r["func"], "observation"),
                ]
                for r in images
            ],
        )


def _columns(tables: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the table of columns without those of images; `first` and `last` are numbers."""
    images = {row["term"] for row in tables["observations"] if _is_image(row)}
    rows = []
    for row in tables["observation vector"]:
        if row["term"] in images:
            continue
        first, is_slice, stop = str(row["columns"]).partition(":")
        last = int(stop) - 1 if is_slice else int(first)
        rows.append({**row, "first": int(first), "last": last})
    return rows


def _merge_columns(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row for each observation: its columns, and what they belong to."""
    merged: list[dict[str, Any]] = []
    for row in rows:
        name = re.sub(r"\w+/", "", str(row.get("link or joint") or ""))
        if merged and merged[-1]["term"] == row["term"] and merged[-1]["scale"] == row["scale"]:
            merged[-1]["last"] = row["last"]
            if name not in merged[-1]["names"]:
                merged[-1]["names"].append(name)
            continue
        merged.append(
            {
                "term": row["term"],
                "scale": row["scale"],
                "first": row["first"],
                "last": row["last"],
                "names": [name],
            }
        )
    for row in merged:
        same = row["first"] == row["last"]
        row["columns"] = str(row["first"]) if same else f"{row['first']} to {row['last']}"
        names = [name for name in row["names"] if name]
        row["of"] = ", ".join(names)
        if len(names) > MANY_NAMES:
            row["of"] = f"{names[0]}, ..., {names[-1]} ({len(names)})"
    return merged


def _terms(
    title: str, kind: str, rows: Sequence[Mapping[str, Any]], keys: Sequence[str], note: str = ""
) -> Iterator[str]:
    """A section about the terms of one manager; none without terms and note."""
    if not rows and not note:
        return
    yield f"## {title}"
    yield ""
    if note and (rows or title == "Terminations"):
        yield note
        yield ""
    if not rows:
        if title != "Terminations":
            yield "None."
            yield ""
        return
    shown = [key for key in keys if any(row.get(key) not in (None, "") for row in rows)]
    yield from _table(
        ["name", "term", *shown],
        [
            [
                f"`{row['term']}`",
                _described(row["func"], kind),
                *(_code(row.get(key), is_flow=key in ("shape", "params")) for key in shown),
            ]
            for row in rows
        ],
    )


def _solutions(task: str, cfg: Mapping[str, Any]) -> Iterator[str]:
    yield "## How it is solved"
    yield ""
    answers = solutions(task, cfg)
    if not answers:
        if task in WITHOUT_SUCCESS:
            yield "There is nothing to solve: the task is an example for scenes, logs and speed."
        else:
            yield (
                "No policy ships, and no training was recorded; `embodichain train` tries what the "
                "file suggests."
            )
        yield ""
        return
    yield "Success with its 95 % interval ([what it means](../success.md)):"
    yield ""
    yield from _table(["by", "success", "command"], [answer.row() for answer in answers])


def _training(training: Mapping[str, Any]) -> Iterator[str]:
    if not training:
        return
    steps = training["total_timesteps"]
    steps_text = f"{steps:,}" if steps else "the default number of"
    yield (
        f"`train` uses {training['algo']} with {training['num_envs']} environments for "
        f"{steps_text} steps ([settings for your task](../settings.md))."
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    if not rows:
        return
    yield "| " + " | ".join(head) + " |"
    yield "| " + " | ".join("---" for _ in head) + " |"
    for row in rows:
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
    yield ""


def _described(func: str, kind: str) -> str:
    """A term's name with a link, and what it computes.

    Args:
        func: The term.
        kind: What it is here, such as ``reward``: one name may be several terms.
    """
    summary = _summary(func, kind)
    return f"{_term_link(func)}: {summary}" if summary else _term_link(func)


def _summary(func: str, kind: str) -> str:
    """The first sentence about a term, without the shape that it begins with."""
    if not func or ":" in func:
        return ""
    entries = find_entries(func)
    entry = next((entry for entry in entries if kind in entry.kinds), entries[0])
    summary = " ".join(entry.doc.summary.replace("``", "`").split())
    summary = ALIAS.sub("", summary).partition(". ")[0]
    summary = SHAPE.sub(lambda match: match[1].upper(), summary)
    return summary.rstrip(".")


def _term_link(func: str) -> str:
    if ":" in func:
        return f"`{func}`"
    is_alias = all(ALIAS.match(entry.doc.summary) for entry in find_entries(func))
    return f"[`{func}`](../terms.md#{'other-names' if is_alias else func.lower()})"


def _is_image(row: Mapping[str, Any]) -> bool:
    return str(row["shape"]).count(",") >= 2


def _width(rows: Sequence[Mapping[str, Any]]) -> int:
    return sum(row["last"] - row["first"] + 1 for row in rows)


def _bounds(space: Mapping[str, Any]) -> str:
    low, high = space["low"], space["high"]
    if isinstance(low, list) or isinstance(high, list):
        return "with the bounds of each column below"
    return f"each from {_cell(low)} to {_cell(high)}"


def _without_none(row: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if value not in (None, "")}


def _cell(value: Any) -> str:
    """A value as a reader wants it: four digits, ranges as `low to high`."""
    if value is None or value == "":
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)) and len(value) == 2:
        return f"{_cell(value[0])} to {_cell(value[1])}"
    return str(value)


def _code(value: Any, *, is_flow: bool) -> str:
    if value is None or value == "":
        return ""
    if not is_flow:
        return _cell(value)
    if isinstance(value, str):
        return f"`{value}`"
    flow = yaml.safe_dump(value, default_flow_style=True, width=10_000, sort_keys=False)
    return f"`{flow.removesuffix(chr(10)).removesuffix('...').strip()}`"


def _limit(episode: str) -> str:
    """When an episode is truncated, from the row of `show`."""
    if episode == "no limit":
        return "Episodes have no time limit."
    steps, _, seconds = episode.partition(" = ")
    return f"An episode is truncated after {steps} ({seconds})."


def main() -> None:
    """Write pages, and films where they are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", help="all, if none is named")
    parser.add_argument("--films", action="store_true", help="draw the films, too")
    options = parser.parse_args()
    FOLDER.mkdir(exist_ok=True)
    for task in options.tasks or list_options("task"):
        if options.films:
            film(task)
        (FOLDER / f"{task}.md").write_text(page(task), encoding="utf-8")
        print(f"docs/tasks/{task}.md", flush=True)


if __name__ == "__main__":
    main()
