"""`page_of_run`: the page of a run, a training, an evaluation or a collection.

Pictures, films and curves are in the page itself; it loads nothing. Sections without content are
left out.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from embodichain.cli.pages.curves import log_charts, training_charts
from embodichain.cli.pages.episodes import PlayedEpisode, counted_episodes, read_episodes
from embodichain.cli.pages.figures import ValueGroup, bar, distribution
from embodichain.cli.pages.galleries import (
    Film,
    Gallery,
    draw_episode,
    draw_failures,
    film_episode,
)
from embodichain.cli.pages.headline import headline
from embodichain.cli.pages.page import data_url, render_page
from embodichain.cli.pages.run_record import (
    RunRecord,
    named_damage,
    read_json,
    read_record,
    read_text,
)
from embodichain.cli.results.summaries import result_rows
from embodichain.cli.terminal.output import number
from embodichain.cli.words import log_warnings
from embodichain.config.composition.locate import display_path
from embodichain.config.run_folder import CONFIG, SUMMARY
from embodichain.utils.env_text import recorded_texts, shown
from embodichain.utils.errors import EmbodichainError
from embodichain.utils.number_text import result_number

if TYPE_CHECKING:
    from embodichain.recording.read.summary import LogSummary

__all__ = ["fact_rows", "page_of_run"]

_MOST_EPISODES = 1000
"""Rows of the folded table."""
_MOST_MESSAGES = 300
_LARGEST_FILM = 64 * 2**20
"""Bytes of films in the page; a third is added by their encoding."""
_FILMS = {".mp4": "video/mp4", ".gif": "image/gif"}
"""Suffix -> type of a film."""
_ABOUT_EXPLORATION = (
    "Curves are of the training, in which actions are drawn at random, or with noise, to explore; "
    "each point is a mean over the last episodes. The evaluation plays the mean action, so its "
    "results may be better than where the curves end."
)
_OUTCOMES = ((True, "success", "good"), (False, "no success", "bad"), (None, "", "plain"))
"""Success of an episode, its legend, and its colour."""
_NOTHING: tuple[Any, ...] = (None, "", "-", [], (), {})
Rows = list[tuple[str, str]]


def page_of_run(
    folder: Path, *, draws_film: bool = False, say: Callable[[str], None] = lambda line: None
) -> str:
    """Return the report of a run as HTML.

    Args:
        folder: The run's folder.
        draws_film: Whether an episode of a training or an evaluation without a film is filmed from
            the log, else it has five pictures. It takes seconds.
        say: Called with a line before that.

    Raises:
        ConfigError: If it is not a run's folder, or a file in it is damaged.
    """
    with named_damage(folder):
        record = read_record(folder)
        notes = _notes(record)
        log = _log(record, notes)
        episodes = read_episodes(record, log)
        films = _films(folder, notes)
        if draws_film and not films and record.kind in ("training", "evaluation"):
            film = film_episode(
                episodes, lambda: say("drawing an episode: --no-film leaves it out")
            )
            films = [] if film is None else [film]
        context = _context(record, log, episodes, films, notes)
        return render_page("run.html.tmpl", context)


def _context(
    record: RunRecord,
    log: LogSummary | None,
    episodes: Sequence[PlayedEpisode],
    films: Sequence[Film],
    notes: list[str],
) -> dict[str, Any]:
    """The variables of the template."""
    folder = record.folder
    strip = Gallery() if films else draw_episode(record, episodes)
    failures = draw_failures(episodes)
    return {
        "title": f"{record.task}: {record.kind}",
        "record": record,
        "folder": display_path(folder),
        "begun": f"{record.begun:%Y-%m-%d %H:%M}",
        "setting": _setting(record.summary),
        "description": _description(record.config),
        "notes": notes,
        "picture_notes": [note for note in (strip.note, failures.note) if note],
        "results": headline(record, episodes),
        "films": films,
        "strip": strip,
        "charts": _charts(record, log, notes),
        "distributions": _distributions(counted_episodes(episodes)),
        "failures": failures,
        "episodes": _episode_rows(episodes[:_MOST_EPISODES]),
        "num_episodes": len(episodes),
        "counting": _counting(log),
        "about_curves": _about_curves(record),
        "rewards": _rewards(record.outcome),
        "rows": fact_rows(result_rows(record.summary, record.evaluation)),
        "training": _training(record),
        "commands": _commands(record, has_log=log is not None),
        "working_dir": _other_working_dir(record),
        "log": _log_facts(log),
        "config": read_text(folder / CONFIG),
        "overrides": "\n".join(record.overrides),
        "messages": "\n".join(read_text(folder / "run.log").splitlines()[-_MOST_MESSAGES:]),
        "versions": _versions(folder),
    }


def _notes(record: RunRecord) -> list[str]:
    """How the run failed, and texts of its config that came from the environment."""
    notes = []
    if not record.outcome:
        notes.append(f"no {SUMMARY}: the run did not end, or was killed")
    if "error" in record.outcome:
        notes.append(f"failed: {record.outcome['error']}")
    for path, text in recorded_texts(record.written_config):
        notes.append(f"from a variable of the environment: {path}: {shown(text)}")
    return notes


def _setting(summary: Mapping[str, Any]) -> str:
    """``ppo, seed 3, 64 environments``; what is not known is left out."""
    parts = []
    if summary.get("algo"):
        parts.append(str(summary["algo"]))
    if summary.get("seed") is not None:
        parts.append(f"seed {summary['seed']}")
    count = summary.get("num_envs")
    if count is not None:
        parts.append(f"{count:,} environment{'s' * (count > 1)}")
    return ", ".join(parts)


def _description(config: Mapping[str, Any]) -> str:
    task = config.get("task")
    return str(task.get("description") or "") if isinstance(task, dict) else ""


def _log(record: RunRecord, notes: list[str]) -> LogSummary | None:
    """The summary of a log, if there is one; adds warnings about it."""
    if record.log is None:
        return None
    from embodichain.recording import inspect

    try:
        summary = inspect(record.log)
    except EmbodichainError as error:
        notes.append(f"the log cannot be read: {error}")
        return None
    notes += [f"log: {warning}" for warning in log_warnings(summary)]
    return summary


def fact_rows(rows: Iterable[tuple[str, Any]]) -> Rows:
    """Return names and texts of the values that say something: neither None nor empty."""
    return [(name, number(value)) for name, value in rows if value not in _NOTHING]


# -- pictures --------------------------------------------------------------------------------------


def _films(folder: Path, notes: list[str]) -> list[Film]:
    """The films in a run's folder; adds notes about those that are too large."""
    films = []
    total = 0
    paths = [path for path in folder.iterdir() if path.suffix in _FILMS]
    for path in sorted(paths):
        if path.name.startswith("."):  # not complete
            continue
        total += path.stat().st_size
        if total > _LARGEST_FILM:
            notes.append(f"{path.name} is not in the page: films may have {_LARGEST_FILM:,} bytes")
        else:
            source = data_url(path.read_bytes(), _FILMS[path.suffix])
            films.append(Film(source, caption=path.name))
    return films


# -- figures ---------------------------------------------------------------------------------------


def _charts(record: RunRecord, log: LogSummary | None, notes: list[str]) -> list[Markup]:
    """Curves of a training, or else rewards of the log."""
    from embodichain.recording.format.log_error import LogError

    charts = training_charts(record.folder)
    if charts or log is None:
        return charts
    try:
        return log_charts(log)
    except LogError as error:  # no rewards are in the log, or it is damaged
        notes.append(f"no curves: {error}")
        return []


def _distributions(episodes: Sequence[PlayedEpisode]) -> list[Markup]:
    """How returns and lengths are distributed, by success if the task has one."""
    if len(episodes) < 2:
        return []
    figures = []
    for title, column in (("return", "total_reward"), ("length in control steps", "length")):
        groups = [
            ValueGroup(
                values=[getattr(e, column) for e in episodes if e.success == success],
                label=label,
                color=color,
            )
            for success, label, color in _OUTCOMES
        ]
        if column == "total_reward" and not any(episode.total_reward for episode in episodes):
            continue  # a task without rewards
        figures.append(distribution(title, groups, note=f"{len(episodes):,} episodes"))
    return figures


def _rewards(outcome: Mapping[str, Any]) -> list[tuple[str, str, Markup]]:
    """Name, value and bar of each reward term."""
    evaluation = outcome.get("eval") or {}
    rewards = outcome.get("rewards") or evaluation.get("rewards") or {}
    values = {name: float(value) for name, value in rewards.items() if value is not None}
    largest = max(map(abs, values.values()), default=0.0)
    is_signed = any(value < 0 for value in values.values())
    return [
        (name, number(value), bar(value, largest, is_signed=is_signed))
        for name, value in values.items()
    ]


# -- tables ----------------------------------------------------------------------------------------


def _episode_rows(episodes: Sequence[PlayedEpisode]) -> list[dict[str, str]]:
    """The cells of episodes; columns that none of them has are left out."""
    rows = []
    for episode in episodes:
        cells = {
            "env": episode.env,
            "episode": episode.episode,
            "steps": episode.length,
            "return": episode.total_reward,
            "success": episode.success,
            "ended by": episode.end,
            "counted": episode.counted,
            "last step in the log": episode.last_step if episode.log is not None else None,
            "drawn": _drawn_text(episode.drawn),
        }
        rows.append({name: "" if cell is None else number(cell) for name, cell in cells.items()})
    if not rows:
        return []
    columns = [name for name in rows[0] if any(row[name] for row in rows)]
    return [{name: row[name] for name in columns} for row in rows]


def _drawn_text(drawn: Mapping[str, Sequence[float]]) -> str:
    """``place_cube.position 0.58 0.14 0.05; friction.friction 0.9``."""
    draws = []
    for name, numbers in drawn.items():
        values = " ".join(result_number(value) for value in numbers)
        draws.append(f"{name} {values}")
    return "; ".join(draws)


def _training(record: RunRecord) -> dict[str, Any]:
    """Where the policy of a run was trained, with that run's results and curves.

    Empty if the policy is not a file of another training's folder.
    """
    folder = record.policy_run
    if folder is None:
        return {}
    training = read_record(folder)
    if "algo" not in training.summary:
        return {}
    return {
        "folder": display_path(folder),
        "rows": fact_rows(result_rows(training.summary, {})),
        "charts": training_charts(folder),
        "about_curves": _about_curves(record) if training.summary["algo"] != "bc" else "",
        "command": f"embodichain report {shlex.quote(display_path(folder))}",
    }


def _versions(folder: Path) -> Rows:
    return [
        (package, str(version))
        for package, version in read_json(folder / "versions.json").items()
        if version
    ]


def _log_facts(log: LogSummary | None) -> Rows:
    if log is None:
        return []
    header = log.header
    ended = f"{len(log.episodes):,}"
    counting = _counting(log)
    if counting:
        ended += f", of which {counting}"
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


def _counting(log: LogSummary | None) -> str:
    """``100 count: the first of each environment``; empty if the log does not say which count."""
    if log is None or log.counted is None:
        return ""
    reason = "the first of each environment" if log.header.quota else "those that were needed"
    return f"{log.counted:,} count: {reason}"


def _about_curves(record: RunRecord) -> str:
    """Why a policy that is evaluated may be better than its curves; empty where that is not so."""
    evaluation = record.evaluation or record.summary.get("eval") or {}
    explores = record.summary.get("algo") != "bc"
    return _ABOUT_EXPLORATION if evaluation.get("deterministic") and explores else ""


# -- commands --------------------------------------------------------------------------------------


def _other_working_dir(record: RunRecord) -> str:
    """Where the command was typed, unless that is here."""
    if record.working_dir is None or record.working_dir == Path.cwd():
        return ""
    return str(record.working_dir)


def _commands(record: RunRecord, *, has_log: bool) -> list[tuple[str, str]]:
    """Descriptions and commands that repeat, replay or continue the run."""
    run = shlex.quote(display_path(record.folder))
    commands = []
    typed = shlex.join(record.command)
    if typed:
        commands.append(("As it was run", typed))
        has_seed = any(word.startswith("seed=") for word in record.command)
        # The config of an evaluation has its environments' seed, which is not the one to type.
        source = record.evaluation if record.kind == "evaluation" else record.config
        if not has_seed and source.get("seed") is not None:
            with_seed = f"{typed} seed={source['seed']}"
            commands.append(("The same random numbers again", with_seed))
    if record.kind == "collection":
        commands.append(("Continue the collection", f"embodichain collect resume={run}"))
    if record.kind == "training":
        task = shlex.quote(record.task)
        commands += [
            ("Evaluate the policy", f"embodichain eval {run}"),
            ("Play the policy", f"embodichain run task={task} policy={run}"),
        ]
    if has_log:
        commands += [
            ("Simulate the log again and compare every bit", f"embodichain replay {run} --verify"),
            ("Play the log in a browser", f"embodichain replay {run} --view web"),
            ("Open the log in Foxglove or Lichtblick", f"embodichain view {run}"),
        ]
    return commands
