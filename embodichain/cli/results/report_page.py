"""The page of `embodichain report`: what a run's folder contains, as one HTML file.

Pictures, films and curves are in the page itself; it loads nothing. Sections without content are
left out.
"""

from __future__ import annotations

import base64
import importlib.util
import json
import math
import shlex
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib import resources
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml

from embodichain.cli.terminal.output import number
from embodichain.config.composition.locate import display_path
from embodichain.config.run_folder import CHECKPOINT, CONFIG, LOG, SUMMARY
from embodichain.utils.env_text import recorded_texts, shown
from embodichain.utils.errors import ConfigError, EmbodichainError
from embodichain.utils.system.atomic import remove_abandoned

if TYPE_CHECKING:
    from embodichain.learning.evaluation.comparison import Curve
    from embodichain.recording.read.episodes import LogEpisode
    from embodichain.recording.read.summary import LogSummary

__all__ = ["page_of"]

_MOST_EPISODES = 50
_MOST_MESSAGES = 300
_MOST_POINTS = 500
_LARGEST_FILM = 64 * 2**20
"""Bytes of films in the page; a third is added by their encoding."""
_EPISODE = ("env", "episode", "steps", "total_reward", "terminated", "last_step", "success")
_REWARD = "Episode_Reward/"
"""Before the names of reward terms in `progress.csv`."""
Rows = list[tuple[str, Any]]


def page_of(folder: Path) -> str:
    """Return the report of a run, a training or an evaluation, as HTML.

    Args:
        folder: The run's folder.

    Raises:
        ConfigError: If it is not a run's folder, or a file in it is damaged.
    """
    from jinja2 import Environment

    if not (folder / CONFIG).is_file():
        raise ConfigError(f"{folder} is not a run's folder: it has no {CONFIG}")
    remove_abandoned(folder)
    remove_abandoned((folder / CHECKPOINT).parent)
    config = _yaml(folder / CONFIG)
    summary = shown(_json(folder / SUMMARY))
    evaluation = shown(_json(folder / "eval.json"))
    outcome = summary or evaluation
    kind = _kind_of(folder, summary, evaluation)
    # The result of an evaluation has no status: it is written when it has finished.
    status = str(outcome.get("status", "finished")) if outcome else "unfinished"
    task = str(outcome.get("task", folder.name.partition("_")[2]))
    begun = datetime.fromtimestamp((folder / CONFIG).stat().st_mtime)
    log, log_notes = _log(folder / LOG)
    films, film_notes = _films(folder)
    curves, curve_notes = _curves(folder, log)
    episodes = [] if log is None else log.episodes
    context = {
        "title": f"{task}: {kind}",
        "task": task,
        "kind": kind,
        "status": status,
        "bad": status in ("failed", "unfinished"),
        "folder": display_path(folder),
        "begun": f"{begun:%Y-%m-%d %H:%M:%S}",
        "description": shown(config.get("task", {}).get("description", "")),
        "notes": [*_notes(outcome, config), *log_notes, *film_notes, *curve_notes],
        "results": [(name, number(value)) for name, value in _results(summary, evaluation)],
        "films": films,
        "picture": _data_url(folder / "scene.png", "image/png"),
        "curves": curves,
        "training": _training(folder, config.get("policy")),
        "rewards": _rewards(summary, evaluation),
        "episodes": _episode_rows(episodes[:_MOST_EPISODES]),
        "more_episodes": max(len(episodes) - _MOST_EPISODES, 0),
        "commands": _commands(folder, kind, task, config, has_log=log is not None),
        "log": _log_facts(log),
        "config": _text(folder / CONFIG),
        "overrides": "\n".join(map(str, _yaml(folder / "overrides.yaml") or [])),
        "messages": "\n".join(_text(folder / "run.log").splitlines()[-_MOST_MESSAGES:]),
        "versions": [
            (package, version or "not installed")
            for package, version in _json(folder / "versions.json").items()
        ],
    }
    template = resources.files("embodichain.cli") / "templates" / "report.html.tmpl"
    page = Environment(autoescape=True).from_string(template.read_text(encoding="utf-8"))
    return page.render(context)


def _kind_of(folder: Path, summary: Mapping[str, Any], evaluation: Mapping[str, Any]) -> str:
    """The kind of a run, in a word."""
    from embodichain.recording.demos.collection import is_collection

    if is_collection(folder):
        return "collection"
    # A training may be evaluated in its own folder, which is then still a training's.
    if "algo" in summary or (folder / "progress.csv").exists():
        return "training"
    if evaluation:
        return "evaluation"
    return "run"


def _notes(outcome: Mapping[str, Any], config: Mapping[str, Any]) -> list[str]:
    """How the run failed, and texts of its config that came from the environment."""
    notes = []
    if not outcome:
        notes.append(f"no {SUMMARY}: the run did not end, or was killed")
    if "error" in outcome:
        notes.append(f"failed: {outcome['error']}")
    for path, text in recorded_texts(config):
        notes.append(f"from a variable of the environment: {path}: {shown(text)}")
    return notes


def _episode_rows(episodes: Sequence[LogEpisode]) -> list[dict[str, str]]:
    """The cells of episodes of the log; what was drawn for them if it is known of any."""
    rows = [_episode_row(episode) for episode in episodes]
    if any(episode.drawn for episode in episodes):
        for row, episode in zip(rows, episodes, strict=True):
            row["drawn"] = _drawn_text(episode.drawn)
    return rows


def _drawn_text(drawn: Mapping[str, Sequence[float]]) -> str:
    """``place_cube.position 0.58 0.14 0.05; friction.friction 0.9``."""
    draws = []
    for name, numbers in drawn.items():
        values = " ".join(f"{value:.4g}" for value in numbers)
        draws.append(f"{name} {values}")
    return "; ".join(draws)


def _episode_row(episode: LogEpisode) -> dict[str, str]:
    """The cells of one episode of the log."""
    row = {name: number(getattr(episode, name)) for name in _EPISODE}
    if episode.counted is not None:
        row["counted"] = number(episode.counted)
    return row


# -- files of a run --------------------------------------------------------------------------------


def _text(path: Path) -> str:
    """The content of a file, or an empty string."""
    try:
        return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error}") from error


def _json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(_text(path) or "{}")
    except ValueError as error:
        raise ConfigError(f"{path} is damaged: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path} is damaged: it is not a map")
    return data


def _yaml(path: Path) -> Any:
    try:
        return yaml.safe_load(_text(path))
    except yaml.YAMLError as error:
        raise ConfigError(f"{path} is damaged: {error}") from error


def _data_url(path: Path, kind: str) -> str:
    """A file as the address of its content; empty without the file."""
    if not path.is_file():
        return ""
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"


_FILMS = {".mp4": "video/mp4", ".gif": "image/gif"}
"""Suffix -> type of a film."""


def _films(folder: Path) -> tuple[list[tuple[str, str]], list[str]]:
    """Name and address of each film, and notes about films that are too large."""
    films = []
    notes = []
    total = 0
    paths = [path for path in folder.iterdir() if path.suffix in _FILMS]
    for path in sorted(paths):
        total += path.stat().st_size
        if total > _LARGEST_FILM:
            notes.append(f"{path.name} is not in the page: films may have {_LARGEST_FILM:,} bytes")
        else:
            films.append((path.name, _data_url(path, _FILMS[path.suffix])))
    return films, notes


def _log(path: Path) -> tuple[LogSummary | None, list[str]]:
    """The summary of a log, if there is one, and warnings about it."""
    if not path.exists():
        return None, []
    from embodichain.recording import inspect

    try:
        summary = inspect(path)
    except EmbodichainError as error:
        return None, [f"the log cannot be read: {error}"]
    return summary, [f"log: {warning}" for warning in summary.warnings]


# -- sections --------------------------------------------------------------------------------------


def _results(summary: Mapping[str, Any], evaluation: Mapping[str, Any]) -> Rows:
    """The table that the command printed, without rewards, which have a section."""
    if summary.get("status") == "failed":
        rows = list(summary.items())
    elif "algo" in summary:
        from embodichain.cli.results.summaries import training_rows as rows_of_training

        rows = rows_of_training(summary)
    elif "successes_wanted" in summary:
        from embodichain.cli.results.summaries import collection_rows as rows_of_collection

        rows = rows_of_collection(summary)
    elif summary:
        from embodichain.cli.results.summaries import run_rows

        rows = run_rows(summary)
    elif evaluation:
        from embodichain.cli.results.summaries import evaluation_rows

        rows = evaluation_rows(evaluation)
    else:
        rows = []
    return [(name, value) for name, value in rows if not name.startswith("reward ")]


def _training(folder: Path, policy: Any) -> dict[str, Any]:
    """Where the policy of a run was trained, with that run's results and curves.

    Empty if the policy is not a file of another training's folder.
    """
    if not isinstance(policy, str):
        return {}
    file = Path(policy)
    runs = [run for run in (file, *file.parents[:2]) if (run / SUMMARY).is_file()]
    if not runs or runs[0].resolve() == folder:
        return {}
    training = runs[0]
    summary = _json(training / SUMMARY)
    if "algo" not in summary:
        return {}
    curves, notes = _curves(training, None)
    return {
        "folder": display_path(training),
        "results": [(name, number(value)) for name, value in _results(summary, {})],
        "curves": curves,
        "notes": notes,
        "command": f"embodichain report {shlex.quote(display_path(training))}",
    }


def _rewards(
    summary: Mapping[str, Any], evaluation: Mapping[str, Any]
) -> list[tuple[str, str, float]]:
    """Name, value, and share of the largest of each reward term."""
    rewards = summary.get("rewards") or evaluation.get("rewards") or {}
    values = {name: float(value) for name, value in rewards.items() if value is not None}
    largest = max(map(abs, values.values()), default=0.0) or 1.0
    return [(name, number(value), value / largest) for name, value in values.items()]


def _log_facts(log: LogSummary | None) -> Rows:
    if log is None:
        return []
    header = log.header
    ended = f"{len(log.episodes):,}"
    if log.counted is not None:
        counting = "the first of each environment" if header.quota else "those that were needed"
        ended += f", of which {log.counted:,} count: {counting}"
    verifiable = "yes"
    if header.unverifiable:
        verifiable = f"no: {header.unverifiable}"
    return [
        ("file", f"{log.path.name}, {log.nbytes / 1e6:.2f} MB"),
        ("recorded with", header.recorded_with),
        ("environments", f"{header.num_envs}, seed {header.seed}"),
        ("steps", f"{log.steps:,} control steps = {log.duration_s:.2f} s simulated"),
        ("episodes that ended", ended),
        ("verifiable", verifiable),
    ]


def _commands(
    folder: Path, kind: str, task: str, config: Mapping[str, Any], *, has_log: bool
) -> list[tuple[str, str]]:
    """Descriptions and commands that repeat, replay or continue the run."""
    run = shlex.quote(display_path(folder))
    commands = []
    typed = _text(folder / "command.txt").strip().rpartition("\n")[2]
    if typed:
        commands.append(("As it was run", typed))
        has_seed = any(word.startswith("seed=") for word in shlex.split(typed))
        if not has_seed:
            with_seed = f"{typed} seed={config.get('seed')}"
            commands.append(("The same random numbers again", with_seed))
    if kind == "collection":
        commands.append(("Continue the collection", f"embodichain collect resume={run}"))
    if kind == "training":
        commands += [
            ("Evaluate the policy", f"embodichain eval {run}"),
            ("Play the policy", f"embodichain run task={shlex.quote(task)} policy={run}"),
        ]
    if has_log:
        commands += [
            ("Simulate the log again and compare every bit", f"embodichain replay {run} --verify"),
            ("Play the log in a browser", f"embodichain replay {run} --view web"),
            ("Open the log in Foxglove or Lichtblick", f"embodichain view {run}"),
        ]
    return commands


# -- curves ----------------------------------------------------------------------------------------


class Panel(NamedTuple):
    """Curves in one pair of axes.

    Attributes:
        title: Above the axes.
        curves: By name, for the legend if there are several.
        share: Whether values are shares, such as success rates.
        x_label: Below the axes.
        line: Style of matplotlib: a line or dots.
    """

    title: str
    curves: dict[str, Curve]
    share: bool = False
    x_label: str = "environment steps"
    line: str = "-"


def _curves(folder: Path, log: LogSummary | None) -> tuple[str, list[str]]:
    """Curves of a training, or else rewards of the log, as SVG; and notes."""
    from embodichain.recording.format.log_error import LogError

    try:
        panels = _panels(folder, log)
    except LogError as error:  # no rewards are in the log, or it is damaged
        return "", [f"no curves: {error}"]
    if not panels:
        return "", []
    if importlib.util.find_spec("matplotlib") is None:
        return "", ["curves need the package matplotlib: pip install 'embodichain[plot]'"]
    return _svg(panels), []


def _panels(folder: Path, log: LogSummary | None) -> list[Panel]:
    from embodichain.learning.evaluation.comparison import (
        LENGTH,
        PROGRESS,
        RETURN,
        SUCCESS,
        read_curves,
    )

    titles = {RETURN: "mean return", SUCCESS: "success rate", LENGTH: "mean length, control steps"}
    prefixes = (*titles, _REWARD)
    curves = read_curves(folder / PROGRESS, lambda name: name.startswith(prefixes))
    panels = [
        Panel(title, {title: curves[name]}, share=name == SUCCESS)
        for name, title in titles.items()
        if name in curves
    ]
    terms = {
        name.removeprefix(_REWARD): curve for name, curve in curves.items() if name not in titles
    }
    if terms:
        panels.append(Panel("rewards by term", terms))
    if not panels and log is not None:
        return _panels_of_log(log)
    return panels


def _panels_of_log(log: LogSummary) -> list[Panel]:
    """Rewards over control steps, and returns of episodes; empty for a task without rewards."""
    from embodichain.learning.evaluation.comparison import Curve
    from embodichain.recording import open as open_log

    panels = []
    with open_log(log.path) as reader:
        rewards = reader.read("rewards")["rewards"].mean(axis=1, dtype=np.float64)
    if rewards.any():
        # Means of equal parts, so that a long run has as many points as the picture has pixels.
        size = math.ceil(len(rewards) / _MOST_POINTS)
        starts = np.arange(0, len(rewards), size)
        means = np.add.reduceat(rewards, starts) / np.diff(starts, append=len(rewards))
        steps = log.header.first_step + starts.astype(np.float64)
        mean = {"reward": Curve(steps, means)}
        panels.append(Panel("mean reward of a control step", mean, x_label="control steps"))
    returns = np.array([episode.total_reward for episode in log.episodes])
    if returns.any() and len(returns) > 1:
        order = "episode, in the order of their ends"
        dots = {"return": Curve(np.arange(len(returns), dtype=np.float64), returns)}
        panels.append(Panel("return of each episode", dots, x_label=order, line="."))
    return panels


def _svg(panels: Sequence[Panel]) -> str:
    """Draw panels, two in a row."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from embodichain.learning.evaluation.plots import set_axes

    rows = math.ceil(len(panels) / 2)
    stream = StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "report"}):
        figure = Figure(figsize=(11.0, 3.2 * rows), layout="constrained")
        places = iter(figure.subplots(rows, 2, squeeze=False).flat)
        for panel, axes in zip(panels, places, strict=False):  # an odd number leaves one empty
            for name, curve in panel.curves.items():
                line = "o" if len(curve.steps) == 1 else panel.line
                axes.plot(curve.steps, curve.values, line, label=name)
            curves = panel.curves.values()
            last_step = max(float(curve.steps[-1]) for curve in curves)
            values = np.concatenate([curve.values for curve in curves]).tolist()
            set_axes(axes, last_step, values, share=panel.share)
            axes.set_title(panel.title)
            axes.set_xlabel(panel.x_label)
            if len(panel.curves) > 1:
                axes.legend(fontsize="small")
        for axes in places:  # the empty one
            axes.set_axis_off()
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]
