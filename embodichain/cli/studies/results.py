"""The results of a study: summaries over seeds, comparisons of arms, factors; as files and tables.

Everything is computed from the table of episodes, so that a table can be made again from the files.
"""

from __future__ import annotations

import csv
import importlib.util
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from embodichain.cli.jobs.receipt import RECEIPT, write_receipt
from embodichain.cli.results.comparison_tables import describe_means, mean_of_seeds
from embodichain.cli.studies.episode_table import (
    DRAWN,
    EpisodeTable,
    read_episodes,
    write_table,
)
from embodichain.cli.studies.stages import read_stage
from embodichain.cli.studies.study_job import StudyFolder
from embodichain.config.run_folder import STUDY
from embodichain.config.study import Study
from embodichain.learning.evaluation.across_tasks import (
    TaskSummary,
    improvement,
    interquartile_mean,
)
from embodichain.learning.evaluation.factors import (
    FactorBin,
    FactorRanking,
    rank_factors,
    success_by_factor,
)
from embodichain.learning.evaluation.paired import (
    PairedRates,
    PairedValues,
    compare_rates,
    compare_values,
)
from embodichain.learning.evaluation.statistics import CONFIDENCE, SeedEstimate, over_seeds
from embodichain.utils.errors import ConfigError
from embodichain.utils.number_text import result_number
from embodichain.utils.system.atomic import write_text

__all__ = [
    "RANKED_FACTORS",
    "RATES",
    "Factors",
    "StudyResults",
    "fits_models",
    "read_results",
    "write_results",
]

RANKED_FACTORS = "the drawn factor that success depends on most"
"""Title of the table of `StudyResults.ranked_factors`."""
_WITHOUT_MODELS = "the joint model of factors needs statsmodels: embodichain[study]"
RATES = ("success",)
"""Metrics that are shares of episodes."""


@dataclass(frozen=True)
class ArmResult:
    """A metric of an arm on a task under a variation.

    Attributes:
        arm: The arm.
        task: The task.
        variation: The variation.
        metric: The metric.
        episodes: Number of episodes.
        over_seeds: Mean over seeds of the means of their episodes, with an interval over seeds.
    """

    arm: str
    task: str
    variation: str
    metric: str
    episodes: int
    over_seeds: SeedEstimate


@dataclass(frozen=True)
class AcrossTasks:
    """A metric of an arm over all tasks under a variation.

    Attributes:
        arm: The arm.
        variation: The variation.
        metric: The metric.
        iqm: Interquartile mean over seeds and tasks.
        improvement: Probability that it is better than the baseline; None for the baseline.
    """

    arm: str
    variation: str
    metric: str
    iqm: TaskSummary
    improvement: TaskSummary | None


@dataclass(frozen=True)
class Pairs:
    """An arm against the baseline on the same starts.

    Attributes:
        arm: The arm.
        baseline: The baseline.
        task: The task.
        variation: The variation.
        metric: The metric.
        result: The difference, arm less baseline; None where the starts are not the same.
        note: Why there is none.
    """

    arm: str
    baseline: str
    task: str
    variation: str
    metric: str
    result: PairedRates | PairedValues | None
    note: str = ""


@dataclass(frozen=True)
class Factors:
    """Which drawn factor breaks an arm on a task under a variation.

    Attributes:
        arm: The arm.
        task: The task.
        variation: The variation.
        ranking: The joint model; None without the extra ``study``.
        bins: Factor -> success in groups of its values.
    """

    arm: str
    task: str
    variation: str
    ranking: FactorRanking | None
    bins: dict[str, tuple[FactorBin, ...]]


@dataclass(frozen=True)
class StudyResults:
    """The results of a study.

    Attributes:
        study: The study.
        episodes: Its episodes.
        arms: A summary for each arm, task, variation and metric.
        across_tasks: Summaries over tasks; empty with a single task.
        pairs: Comparisons with the baseline on the same starts.
        factors: Analyses of what was drawn.
        notes: What is missing, and why.
        files: The files that were written.
    """

    study: Study
    episodes: EpisodeTable
    arms: tuple[ArmResult, ...]
    across_tasks: tuple[AcrossTasks, ...]
    pairs: tuple[Pairs, ...]
    factors: tuple[Factors, ...]
    notes: tuple[str, ...]
    files: tuple[Path, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON."""
        return {
            "study": self.study.name,
            "arms": [asdict(result) for result in self.arms],
            "across_tasks": [asdict(result) for result in self.across_tasks],
            "pairs": [asdict(result) for result in self.pairs],
            "factors": [asdict(result) for result in self.factors],
            "notes": list(self.notes),
            "files": [str(path) for path in self.files],
        }

    def plain_dict(self) -> dict[str, Any]:
        """Return `as_dict` as JSON has it: lists for tuples, numbers of Python."""
        plain: dict[str, Any] = json.loads(json.dumps(self.as_dict(), default=_plain))
        return plain

    def texts(self) -> dict[str, str]:
        """Return file name -> text of the summaries."""
        return {"summary.csv": _summary_csv(self), "results.md": _markdown(self)}

    def tables(self) -> Iterator[tuple[str, list[dict[str, Any]]]]:
        """Yield a title and rows of text for each table."""
        yield self._arm_table()
        if self.across_tasks:
            yield "over all tasks", [_across_row(result) for result in self.across_tasks]
        if self.pairs:
            rows = [_pair_row(result) for result in self.pairs]
            yield f"difference from {self.study.baseline}, on the same starts", rows
        rows = self.ranked_factors()
        if rows:
            yield RANKED_FACTORS, rows

    def ranked_factors(self) -> list[dict[str, Any]]:
        """Return a row for each analysis that ranks factors; `notes` say why others do not."""
        rows: list[dict[str, Any]] = []
        for factors in self.factors:
            if factors.ranking is not None and factors.ranking.effects:
                rows.append(_factor_row(factors, factors.ranking))
        if not any(row["note"] for row in rows):
            for row in rows:
                del row["note"]
        return rows

    def factor_tables(self) -> Iterator[tuple[str, list[dict[str, Any]]]]:
        """Yield a title and rows for each joint model of factors."""
        for factors in self.factors:
            if factors.ranking is not None and factors.ranking.effects:
                title = f"factors: {factors.arm}, {factors.task}, {factors.variation}"
                yield title, _factor_rows(factors.ranking)

    def _arm_table(self) -> tuple[str, list[dict[str, Any]]]:
        """One row an arm, task and variation; a column a metric."""
        rows: dict[tuple[str, str, str], dict[str, Any]] = {}
        for result in self.arms:
            key = (result.task, result.variation, result.arm)
            row = rows.setdefault(
                key,
                {
                    "task": result.task,
                    "variation": result.variation,
                    "arm": result.arm,
                    "seeds": len(result.over_seeds.values),
                    "episodes": result.episodes,
                },
            )
            row[result.metric] = mean_of_seeds(result.over_seeds, share=result.metric in RATES)
        means = describe_means(result.over_seeds for result in self.arms)
        return f"{self.study.name}: {means}", list(rows.values())


def fits_models() -> bool:
    """Whether the extra ``study`` is installed, which fits joint models of factors."""
    return importlib.util.find_spec("statsmodels") is not None


def write_results(study: Study, place: StudyFolder) -> StudyResults:
    """Compute the results of what is done, and write them into the study's folder.

    Writes ``episodes.csv`` (and ``.parquet``), ``summary.csv``, ``results.json``, ``results.md``,
    and a receipt.

    Args:
        study: The study.
        place: Its folder.

    Raises:
        ConfigError: No evaluation is done, or a file is damaged or cannot be written.
    """
    results = read_results(study, place)
    folder = place.path
    try:
        files = write_table(results.episodes, folder)
        for name, text in results.texts().items():
            write_text(folder / name, text)
            files.append(folder / name)
        files.append(folder / "results.json")
        results = replace(results, files=tuple(files))
        text = json.dumps(results.as_dict(), indent=2, allow_nan=False, default=_plain)
        write_text(folder / "results.json", text + "\n")
        _write_receipt(study, place, results)
    except OSError as error:
        raise ConfigError(f"cannot write the results of the study: {error}") from error
    return results


def _write_receipt(study: Study, place: StudyFolder, results: StudyResults) -> None:
    """Write the receipt of the study, with those of its evaluations among its files."""
    folder = place.path
    receipts: list[Path] = []
    for job in study.jobs():
        for variation in study.variations:
            path = place.evaluation(job, variation) / RECEIPT
            if path.is_file():
                receipts.append(path)
    facts = {
        "study": study.name,
        "seeds": list(study.cfg.seeds),
        "results": results.plain_dict()["arms"],
    }
    files = [folder / STUDY, *results.files, *receipts]
    write_receipt(folder, "study", facts, files=files)


def read_results(
    study: Study, place: StudyFolder, *, has_models: bool | None = None
) -> StudyResults:
    """Compute the results of what is done.

    Args:
        study: The study.
        place: Its folder.
        has_models: Whether to fit the joint models of factors, else a note says that there are
            none; None is whether `fits_models`.

    Raises:
        ConfigError: No evaluation is done, or a file is damaged.
    """
    if has_models is None:
        has_models = fits_models()
    episodes = read_episodes(study, place)
    if not episodes.rows:
        raise ConfigError(f"no evaluation of the study {study.name} is done: {place.path}")
    notes = [f"not done: {job.name}" for job in study.jobs() if not place.is_finished(job)]
    pairs = tuple(_pairs(study, place, episodes)) if len(study.arms) > 1 else ()
    factors = tuple(_factors(study, episodes, notes, has_models=has_models))
    arms = tuple(_arm_results(study, episodes))
    notes += dict.fromkeys(result.over_seeds.note for result in arms if result.over_seeds.note)
    notes += dict.fromkeys(pair.note for pair in pairs if pair.note)
    return StudyResults(
        study=study,
        episodes=episodes,
        arms=arms,
        across_tasks=tuple(_across_tasks(study, episodes)) if len(study.tasks) > 1 else (),
        pairs=pairs,
        factors=factors,
        notes=tuple(notes),
    )


def _arm_results(study: Study, episodes: EpisodeTable) -> Iterator[ArmResult]:
    for task in study.tasks:
        for variation in study.variations:
            for arm in study.arms:
                table = episodes.where(task=task, variation=variation, arm=arm)
                for metric in study.cfg.compare.metrics:
                    means = _seed_means(table, metric)
                    trials = [_count(table, seed) for seed in means] if metric in RATES else None
                    estimate = over_seeds(list(means.values()), trials)
                    if estimate is not None:
                        yield ArmResult(arm, task, variation, metric, len(table.rows), estimate)


def _across_tasks(study: Study, episodes: EpisodeTable) -> Iterator[AcrossTasks]:
    for variation in study.variations:
        for metric in study.cfg.compare.metrics:
            scores: dict[str, list[list[float]]] = {}
            for arm in study.arms:
                table = episodes.where(variation=variation, arm=arm)
                means = [_seed_means(table.where(task=task), metric) for task in study.tasks]
                if all(means):
                    scores[arm] = [list(of_task.values()) for of_task in means]
            for arm, of_tasks in scores.items():
                better: TaskSummary | None = None
                if arm != study.baseline and study.baseline in scores:
                    better = improvement(of_tasks, scores[study.baseline])
                yield AcrossTasks(arm, variation, metric, interquartile_mean(of_tasks), better)


def _pairs(study: Study, place: StudyFolder, episodes: EpisodeTable) -> Iterator[Pairs]:
    for task in study.tasks:
        for variation in study.variations:
            for arm in study.arms:
                if arm == study.baseline:
                    continue
                difference = _differing_starts(study, place, arm, task, variation)
                table = episodes.where(task=task, variation=variation)
                for metric in study.cfg.compare.metrics:
                    facts = (arm, study.baseline, task, variation, metric)
                    if difference:
                        yield Pairs(*facts, result=None, note=difference)
                        continue
                    first, second = _paired_values(table, arm, study.baseline, metric)
                    if not first.size:
                        continue
                    if metric in RATES:
                        yield Pairs(*facts, result=compare_rates(first > 0, second > 0))
                    else:
                        yield Pairs(*facts, result=compare_values(first, second))


_STARTS_DO_NOT_DEPEND_ON = (
    *("rewards", "observations", "actions", "metrics", "terminations", "curriculum", "commands"),
    *("expert", "suggested", "description"),
)
"""Sections of a task that change nothing of the state in which an episode begins."""


def _differing_starts(study: Study, place: StudyFolder, arm: str, task: str, variation: str) -> str:
    """Why episodes of an arm and of the baseline do not begin alike; empty if they do."""
    scenes: dict[str, Any] = {}
    for job in study.jobs():
        if job.task == task and job.arm in (arm, study.baseline) and job.arm not in scenes:
            record = read_stage(place.evaluation(job, variation))
            if record.get("done"):
                declared = record["config"]["task"]
                scenes[job.arm] = {
                    "model": record["inputs"].get("model"),
                    **{k: v for k, v in declared.items() if k not in _STARTS_DO_NOT_DEPEND_ON},
                }
    if len(scenes) < 2:
        return ""
    first, second = scenes.values()
    changed = [key for key in dict.fromkeys([*first, *second]) if first.get(key) != second.get(key)]
    if not changed:
        return ""
    return f"{arm} and {study.baseline} are not paired on {task}: other {', '.join(changed)}"


def _paired_values(
    table: EpisodeTable, arm: str, baseline: str, metric: str
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return (n,) values of both arms on the starts that both have played."""
    values: dict[str, dict[tuple[int, int], float]] = {arm: {}, baseline: {}}
    for row in table.rows:
        if row["arm"] in values and row.get(metric) is not None:
            values[row["arm"]][row["seed"], row["episode"]] = float(row[metric])
    common = [start for start in values[arm] if start in values[baseline]]
    first = np.array([values[arm][start] for start in common])
    second = np.array([values[baseline][start] for start in common])
    return first, second


def _factors(
    study: Study, episodes: EpisodeTable, notes: list[str], *, has_models: bool
) -> Iterator[Factors]:
    """Yield an analysis for each arm, task and variation in which something was drawn."""
    unranked: dict[str, list[str]] = {}
    for task in study.tasks:
        for variation in study.variations:
            for arm in study.arms:
                table = episodes.where(task=task, variation=variation, arm=arm)
                drawn = {name.removeprefix(DRAWN): table.column(name) for name in table.factors}
                success = table.column("success")
                if not drawn or np.isnan(success).any():
                    continue
                ranking: FactorRanking | None = None
                if has_models:
                    ranking = rank_factors(drawn, success > 0)
                    if not ranking.effects:
                        names = unranked.setdefault(_summary_of_notes(ranking), [])
                        names.append(f"{arm} on {task}, {variation}")
                elif _WITHOUT_MODELS not in notes:
                    notes.append(_WITHOUT_MODELS)
                bins = {name: success_by_factor(v, success > 0) for name, v in drawn.items()}
                yield Factors(arm, task, variation, ranking, bins)
    for reason, names in unranked.items():
        notes.append(f"factors are not ranked: {reason} ({'; '.join(names)})")


def _seed_means(table: EpisodeTable, metric: str) -> dict[int, float]:
    """Seed -> mean over its episodes; seeds without the metric are left out."""
    by_seed: dict[int, list[float]] = {}
    for row in table.rows:
        if row.get(metric) is not None:
            by_seed.setdefault(row["seed"], []).append(float(row[metric]))
    return {seed: float(np.mean(values)) for seed, values in by_seed.items()}


def _count(table: EpisodeTable, seed: int) -> int:
    return len(table.where(seed=seed).rows)


# -- as text -----------------------------------------------------------------------------------


def _value_text(metric: str, value: float) -> str:
    return f"{value:.1%}" if metric in RATES else result_number(value)


def _interval_text(metric: str, interval: tuple[float, float] | None) -> str:
    if interval is None:
        return ""
    low, high = interval
    return f" [{_value_text(metric, low)}, {_value_text(metric, high)}]"


def _across_row(result: AcrossTasks) -> dict[str, Any]:
    iqm = _value_text(result.metric, result.iqm.value)
    row = {
        "variation": result.variation,
        "metric": result.metric,
        "arm": result.arm,
        "interquartile mean": iqm + _interval_text(result.metric, result.iqm.interval),
        "better than the baseline": "",
    }
    if result.improvement is not None:
        text = f"{result.improvement.value:.0%}"
        if result.improvement.interval is not None:
            low, high = result.improvement.interval
            text += f" [{low:.0%}, {high:.0%}]"
        row["better than the baseline"] = text
    return row


def _pair_row(pairs: Pairs) -> dict[str, Any]:
    row = {
        "task": pairs.task,
        "variation": pairs.variation,
        "arm": pairs.arm,
        "metric": pairs.metric,
        "difference": "",
        "p": "",
    }
    result = pairs.result
    if result is None:
        row["difference"] = "not paired"
        return row
    metric = pairs.metric
    sign = "+" if result.difference > 0 else ""
    row["difference"] = (
        f"{sign}{_value_text(metric, result.difference)}{_interval_text(metric, result.interval)}"
    )
    if isinstance(result, PairedRates):
        row["p"] = f"{result.p_value:.2g}"
    return row


def _factor_row(factors: Factors, ranking: FactorRanking) -> dict[str, Any]:
    """The first factor of an analysis."""
    first = ranking.effects[0]
    # Bonferroni's correction: the first of several is small by chance more often than one.
    p_value = min(1.0, first.p_value * len(ranking.effects))
    return {
        "task": factors.task,
        "variation": factors.variation,
        "arm": factors.arm,
        "factor": first.name if p_value < 1 - CONFIDENCE else "none found",
        "p": f"{p_value:.2g}",
        "note": _summary_of_notes(ranking),
    }


def _summary_of_notes(ranking: FactorRanking) -> str:
    """The notes of a ranking, with the number of factors that are left out; JSON names them."""
    left_out = [note for note in ranking.notes if note.endswith(": left out")]
    others = [note for note in ranking.notes if note not in left_out]
    if left_out and not others and not ranking.effects:
        others.append("no drawn factor is left")
    if left_out:
        factors = "1 factor" if len(left_out) == 1 else f"{len(left_out)} factors"
        others.append(f"{factors} left out, as they are constant, incomplete or redundant")
    return "; ".join(others)


def _factor_rows(ranking: FactorRanking) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for effect in ranking.effects:
        odds = ""
        if effect.odds_ratio is not None and effect.odds_interval is not None:
            low, high = effect.odds_interval
            odds = f"{effect.odds_ratio:.2g} [{low:.2g}, {high:.2g}]"
        rows.append(
            {
                "factor": effect.name,
                "p": f"{effect.p_value:.2g}",
                "odds for one deviation more": odds,
                "best at": "" if effect.optimum is None else f"{effect.optimum:.3g}",
            }
        )
    return rows


def _summary_csv(results: StudyResults) -> str:
    """One row an arm, task, variation and metric, with numbers."""
    stream = io.StringIO()
    names = ("arm", "task", "variation", "metric", "seeds", "episodes", "mean", "low", "high")
    writer = csv.DictWriter(stream, names)
    writer.writeheader()
    for result in results.arms:
        low, high = result.over_seeds.mean_interval or ("", "")
        writer.writerow(
            {
                "arm": result.arm,
                "task": result.task,
                "variation": result.variation,
                "metric": result.metric,
                "seeds": len(result.over_seeds.values),
                "episodes": result.episodes,
                "mean": result.over_seeds.mean,
                "low": low,
                "high": high,
            }
        )
    return stream.getvalue()


def _markdown(results: StudyResults) -> str:
    """The tables as Markdown."""
    study = results.study
    lines = [f"# {study.name}", "", study.cfg.description, ""]
    for title, rows in [*results.tables(), *results.factor_tables()]:
        lines += [f"## {title}", "", *_markdown_table(rows), ""]
    lines += [f"* {note}" for note in results.notes]
    return "\n".join(lines).rstrip() + "\n"


def _markdown_table(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    names = list(dict.fromkeys(name for row in rows for name in row))
    yield f"| {' | '.join(names)} |"
    yield f"| {' | '.join('---' for _ in names)} |"
    for row in rows:
        yield f"| {' | '.join(str(row.get(name, '')) for name in names)} |"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    return str(value)
