"""The page of a study: results, learning curves, comparisons, factors, and episodes that failed."""

from __future__ import annotations

import importlib.util
import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from embodichain.cli.pages.curves import group_charts
from embodichain.cli.pages.episodes import PlayedEpisode, read_episodes
from embodichain.cli.pages.figures import interval_mark
from embodichain.cli.pages.galleries import Still, draw_failures
from embodichain.cli.pages.headline import Result, seeds_result
from embodichain.cli.pages.page import render_page
from embodichain.cli.pages.run_record import read_record
from embodichain.cli.studies.results import RANKED_FACTORS, RATES, Factors, StudyResults
from embodichain.cli.studies.stages import read_stage
from embodichain.cli.studies.study_job import StudyFolder
from embodichain.config.composition.locate import display_path
from embodichain.config.resolved import dump_yaml
from embodichain.config.study import Study, StudyJob
from embodichain.utils.errors import ConfigError, EmbodichainError
from embodichain.utils.system.atomic import write_text

__all__ = ["page_of_study", "write_page"]

_MOST_EPISODES = 8
"""Failed episodes with a picture."""
_FILM_SIZE = (480, 360)
_FILM_SECONDS = 12.0


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes:
        id: Its anchor.
        title: Its title.
        about: Sentences below the title.
        charts: Figures.
        rows: Rows of its table.
        details: Folded tables, each with a title.
    """

    id: str
    title: str
    about: tuple[str, ...] = ()
    charts: Sequence[Markup] = ()
    rows: Sequence[dict[str, Any]] = ()
    details: Sequence[tuple[str, Sequence[dict[str, Any]]]] = field(default_factory=list)


@dataclass(frozen=True)
class FailedEpisode:
    """An episode on the page.

    Attributes:
        title: Arm, task, seed and variation.
        still: Its last moment.
        film: Address of its film, relative to the page; empty without one.
        log: Address of its log, likewise.
    """

    title: str
    still: Still
    film: str
    log: str


def write_page(
    study: Study, place: StudyFolder, results: StudyResults, say: Callable[[str], None]
) -> Path:
    """Write the page of a study into its folder; arguments as of `page_of_study`.

    Returns:
        The page.

    Raises:
        ConfigError: It cannot be written.
    """
    path = place.path / "report.html"
    try:
        write_text(path, page_of_study(study, place, results, path, say))
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error}") from error
    return path


def page_of_study(
    study: Study,
    place: StudyFolder,
    results: StudyResults,
    out: Path,
    say: Callable[[str], None],
) -> str:
    """Return the page of a study as HTML; films of failed episodes are written beside it.

    Args:
        study: The study.
        place: Its folder.
        results: Its results.
        out: Where the page will be; it links to films and logs from there.
        say: Called with a line if episodes have to be drawn, seconds each.
    """
    notes = list(results.notes)
    unfinished = [job.name for job in study.jobs() if not place.is_finished(job)]
    sections = [_arms(study, results)]
    curves = _curves(study, place, notes)
    if curves is not None:
        sections.append(curves)
    sections += _comparisons(study, results)
    if results.factors:
        sections.append(_factors(results))
    words = [shlex.quote(word) for word in study.overrides]
    context = {
        "title": f"study {study.name}",
        "name": study.name,
        "state": f"{len(unfinished)} jobs unfinished" if unfinished else "finished",
        "num_unfinished": len(unfinished),
        "folder": display_path(place.path),
        "command": " ".join(["embodichain study", study.name, *words]),
        "description": study.cfg.description,
        "results": list(_headline(study, results)),
        "sections": sections,
        "episodes": _failed_episodes(study, place, out, notes, say),
        "notes": notes,
        "files": [(path.name, _address(path, out)) for path in place.tables()],
        "config": dump_yaml(study.tree),
    }
    return render_page("study.html.tmpl", context)


def _headline(study: Study, results: StudyResults) -> Iterator[Result]:
    """Yield the first metric of each arm under the first variation, task by task."""
    metric = study.cfg.compare.metrics[0]
    variation = study.variations[0]
    for result in results.arms:
        if result.metric != metric or result.variation != variation:
            continue
        title = result.arm if len(study.tasks) == 1 else f"{result.arm}, {result.task}"
        is_share = metric in RATES
        yield seeds_result(f"{title}: {metric}", result.over_seeds, is_share=is_share)


def _arms(study: Study, results: StudyResults) -> Section:
    """A row an arm, task and variation, with a drawing of each rate's interval."""
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    (title, text_rows), *_ = results.tables()
    for row in text_rows:
        rows[row["task"], row["variation"], row["arm"]] = dict(row)
    for result in results.arms:
        interval = result.over_seeds.mean_interval
        row = rows[result.task, result.variation, result.arm]
        if result.metric in RATES and interval is not None:
            text = row[result.metric]
            mark = interval_mark(result.over_seeds.mean, *interval)
            row[result.metric] = Markup("{}{}").format(text, mark)
    return Section("results", title, rows=list(rows.values()))


def _curves(study: Study, place: StudyFolder, notes: list[str]) -> Section | None:
    """Learning curves of the arms that train, with intervals over seeds."""
    from embodichain.learning.evaluation.comparison import Group, read_run

    groups: list[Group] = []
    labels: list[str] = []
    for arm in study.arms:
        for task in study.tasks:
            runs = []
            for job in study.jobs():
                is_chosen = (job.arm, job.task) == (arm, task) and job.trains
                if is_chosen and read_stage(place.training(job)).get("done"):
                    runs.append(read_run(place.training(job)))
            if runs:
                label = arm if len(study.tasks) == 1 else f"{arm}, {task}"
                groups.append(Group(label, tuple(runs)))
                labels.append(label)
    if not groups:
        return None
    try:
        charts = group_charts(groups, labels)
    except ValueError as error:  # curves of a group do not fit together
        notes.append(f"no curves: {error}")
        return None
    about = "Mean over seeds with its 95 % interval; below 5 seeds a thin line for each."
    return Section("curves", "Learning curves", about=(about,), charts=charts)


def _comparisons(study: Study, results: StudyResults) -> Iterator[Section]:
    """Yield the tables of results after the first, but that of factors."""
    about = {
        "over all tasks": "Of success rates and the like: the mean over all seeds and tasks "
        "without the lowest and the highest quarter.",
        f"difference from {study.baseline}, on the same starts": "How these policies differ, "
        "episode by episode; p is that of McNemar's exact test.",
    }
    for index, (title, rows) in enumerate(results.tables()):
        if title in about:
            yield Section(f"table-{index}", title.capitalize(), about=(about[title],), rows=rows)


def _factors(results: StudyResults) -> Section:
    """The first factor of each analysis; models, and success by each factor, folded."""
    rows = results.ranked_factors()
    title = RANKED_FACTORS if rows else "success by drawn factor"
    details: list[tuple[str, Sequence[dict[str, Any]]]] = list(results.factor_tables())
    details += [_bins(factors) for factors in results.factors]
    about = "What was drawn for an episode, in groups of its values; the notes below say why "
    about += "factors are not ranked."
    if rows:
        about = "What was drawn for an episode, ranked by what each factor explains of success."
    return Section("factors", title.capitalize(), about=(about,), rows=rows, details=details)


def _bins(factors: Factors) -> tuple[str, list[dict[str, Any]]]:
    """Success in groups of the values of each factor of an analysis."""
    rows: list[dict[str, Any]] = []
    for name, bins in factors.bins.items():
        for group in bins:
            low, high = group.success.interval
            values = f"{group.low:.3g}"
            if group.high != group.low:
                values += f" to {group.high:.3g}"
            rows.append(
                {
                    "factor": name,
                    "values": values,
                    "success": f"{group.success.rate:.0%} of {group.success.trials}",
                    "interval": interval_mark(group.success.rate, low, high),
                }
            )
    return f"Success by factor: {factors.arm}, {factors.task}, {factors.variation}", rows


def _failed_episodes(
    study: Study,
    place: StudyFolder,
    out: Path,
    notes: list[str],
    say: Callable[[str], None],
) -> list[FailedEpisode]:
    """Pictures and films of failed episodes: one of each arm, task and variation in turn."""
    by_place: list[tuple[StudyJob, str, list[PlayedEpisode]]] = []
    for job in study.jobs():
        for variation in study.variations:
            if place.results(job, variation) is not None:
                by_place.append((job, variation, _failed(place.evaluation(job, variation))))
    chosen: list[tuple[StudyJob, str, PlayedEpisode]] = []
    longest = max((len(failed) for _, _, failed in by_place), default=0)
    for index in range(longest):
        for job, variation, failed in by_place:
            if index < len(failed) and len(chosen) < _MOST_EPISODES:
                chosen.append((job, variation, failed[index]))
    if chosen:
        say(f"drawing {len(chosen)} failed episodes for the page")
    episodes: list[FailedEpisode] = []
    for job, variation, episode in chosen:
        gallery = draw_failures([episode])
        if gallery.note:  # nothing can be drawn here, or a log is damaged
            notes.append(gallery.note)
            break
        if gallery.stills and episode.log is not None:
            title = f"{job.arm}, {job.task}, seed {job.seed}, {variation}"
            film = _film(place, job, variation, episode, notes)
            episodes.append(
                FailedEpisode(
                    title=title,
                    still=gallery.stills[0],
                    film="" if film is None else _address(film, out),
                    log=_address(episode.log, out),
                )
            )
    return episodes


def _failed(folder: Path) -> list[PlayedEpisode]:
    """The counted episodes of an evaluation that failed; none without a log."""
    from embodichain.recording import inspect

    record = read_record(folder)
    if record.log is None:
        return []
    episodes = read_episodes(record, inspect(record.log))
    return [episode for episode in episodes if episode.has_failed and episode.counted]


def _film(
    place: StudyFolder, job: StudyJob, variation: str, episode: PlayedEpisode, notes: list[str]
) -> Path | None:
    """Film an episode unless its film is there; return its path, None without one."""
    from embodichain.recording.film.filming import film_log

    suffix = ".mp4" if importlib.util.find_spec("imageio_ffmpeg") is not None else ".gif"
    log_time = 0 if episode.log is None else episode.log.stat().st_mtime_ns
    name = f"{job.name}-{variation}-{episode.env}-{log_time:x}{suffix}"
    path = place.path / "films" / name
    if not path.is_file() and episode.log is not None:
        path.parent.mkdir(exist_ok=True)
        try:
            film_log(
                episode.log,
                path,
                env=episode.env,
                episode=episode.episode,
                size=_FILM_SIZE,
                max_seconds=_FILM_SECONDS,
            )
        except EmbodichainError as error:
            notes.append(f"no film of {job.name}, {variation}: {error}")
            return None
    return path


def _address(path: Path, out: Path) -> str:
    """The address of a file relative to the page."""
    return quote(os.path.relpath(path.resolve(), out.resolve().parent))
