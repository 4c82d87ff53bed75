"""The results that a page begins with: a number, its interval, and what it was measured on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from embodichain.cli.pages.episodes import PlayedEpisode, counted_episodes
from embodichain.cli.pages.figures import interval_mark
from embodichain.cli.pages.run_record import RunRecord
from embodichain.cli.results.comparison_tables import mean_of_seeds
from embodichain.cli.terminal.output import number

if TYPE_CHECKING:
    from embodichain.learning.evaluation.statistics import Estimate, Rate, SeedEstimate

__all__ = ["Result", "estimate_result", "headline", "rate_result", "seeds_result"]


@dataclass(frozen=True, slots=True)
class Result:
    """One number of the headline.

    Attributes:
        name: What was measured.
        text: The value, in words.
        about: Its interval, and what it is from.
        value: The value to sort by; None if it has none.
        mark: A drawing of the interval, perhaps empty.
    """

    name: str
    text: str
    about: tuple[str, ...] = ()
    value: float | None = None
    mark: Markup = Markup("")


def headline(record: RunRecord, episodes: Sequence[PlayedEpisode] = ()) -> list[Result]:
    """Return the results of a run, the most important first.

    Success, return and length have the intervals of `learning.evaluation.statistics`, as `eval`
    and `compare` have them.

    Args:
        record: The run.
        episodes: Its episodes. Without them, the results are those of its files alone, and the mean
            of a simulation has no interval.
    """
    counted = counted_episodes(episodes)
    evaluation = record.evaluation or record.summary.get("eval") or {}
    results: list[Result | None] = []
    if record.kind == "collection":
        results.append(_demonstrations(record.summary))
    results += [
        _success(record, evaluation, counted),
        _mean(record, evaluation, counted, name="return"),
        _mean(record, evaluation, counted, name="length"),
    ]
    if record.kind == "training":
        results.append(_training_time(record.summary))
    return [result for result in results if result is not None]


def rate_result(name: str, rate: Rate | Mapping[str, Any], *, unit: str = "episodes") -> Result:
    """Return a rate with its interval.

    Args:
        name: What it is the rate of.
        rate: The rate, as it is or as `eval.json` has it.
        unit: What the trials are.
    """
    values = rate if isinstance(rate, Mapping) else _fields(rate)
    low, high = values["interval"]
    count = f"{values['count']:,} of {values['trials']:,} {unit}"
    return Result(
        name=name,
        text=f"{values['rate']:.1%}",
        about=(f"95 % interval {low:.1%} to {high:.1%}", count),
        value=float(values["rate"]),
        mark=interval_mark(values["rate"], low, high),
    )


def estimate_result(name: str, estimate: Estimate | Mapping[str, Any], unit: str = "") -> Result:
    """Return a mean with its interval, or with its range if there is no interval.

    Args:
        name: What it is the mean of.
        estimate: The estimate, as it is or as `eval.json` and `summary.json` have it.
        unit: Behind the number.
    """
    values = estimate if isinstance(estimate, Mapping) else _fields(estimate)
    interval = values.get("mean_interval")
    low, high = values["min"], values["max"]
    if low == high:
        about = "in every episode"
    elif interval is not None:
        about = f"95 % interval {number(interval[0])} to {number(interval[1])}"
    else:
        about = f"from {number(low)} to {number(high)}"
    text = f"{number(float(values['mean']))} {unit}".strip()
    return Result(name=name, text=text, about=(about,), value=float(values["mean"]))


def seeds_result(name: str, estimate: SeedEstimate, *, is_share: bool = False) -> Result:
    """Return a mean over seeds with its interval, or with the value of each of too few seeds.

    Args:
        name: What it is the mean of.
        estimate: The mean.
        is_share: Whether it is a share, which is written in percent.
    """
    from embodichain.learning.evaluation.statistics import LEAST_SEEDS

    text, _, rest = mean_of_seeds(estimate, share=is_share).partition(" ")
    count = len(estimate.values)
    about = ["1 seed" if count == 1 else f"{count} seeds"]
    mark = Markup("")
    if estimate.mean_interval is not None:
        low, high = estimate.mean_interval
        about.insert(0, f"95 % interval {rest.strip('[]').replace(', ', ' to ')}")
        mark = interval_mark(estimate.mean, low, high) if is_share else mark
    elif rest:
        values = rest.strip("()").removeprefix("seeds ")
        unit = " in percent" if is_share else ""
        about.append(f"value of each{unit}: {values}")
        about.append(f"an interval needs {LEAST_SEEDS} seeds")
    return Result(name, text, about=tuple(about), value=estimate.mean, mark=mark)


def _fields(value: Any) -> dict[str, Any]:
    return {name: getattr(value, name) for name in value.__dataclass_fields__}


def _success(
    record: RunRecord, evaluation: Mapping[str, Any], episodes: Sequence[PlayedEpisode]
) -> Result | None:
    from embodichain.learning.evaluation.statistics import rate

    if record.kind == "collection":
        successes = int(record.summary.get("successes") or 0)
        trials = successes + int(record.summary.get("failures") or 0)
        name = "yield"
        unit = "attempts"
    elif evaluation.get("success"):
        name = "evaluated success" if record.kind == "training" else "success"
        return rate_result(name, evaluation["success"])
    elif episodes and episodes[0].success is not None:
        successes = sum(bool(episode.success) for episode in episodes)
        trials = len(episodes)
        name = "success"
        unit = "episodes"
    else:
        return _recorded_success(record)
    measured = rate(np.arange(trials) < successes)
    return None if measured is None else rate_result(name, measured, unit=unit)


def _recorded_success(record: RunRecord) -> Result | None:
    """The success rate of a summary: of all episodes of a run, of the last ones of a training."""
    from embodichain.learning.evaluation.comparison import training_trials
    from embodichain.learning.evaluation.statistics import rate

    share = record.summary.get("success_rate")
    if share is None:
        return None
    name = "success"
    trials = int(record.summary.get("episodes") or 0)
    if record.kind == "training":
        name = "success in training"
        trials = training_trials(record.summary)
    measured = rate(np.arange(trials) < round(share * trials))
    return None if measured is None else rate_result(name, measured)


def _mean(
    record: RunRecord,
    evaluation: Mapping[str, Any],
    episodes: Sequence[PlayedEpisode],
    *,
    name: str,
) -> Result | None:
    """The mean return or length of episodes."""
    from embodichain.learning.evaluation.statistics import estimate

    unit = "steps" if name == "length" else ""
    recorded = evaluation.get("returns" if name == "return" else name) or record.summary.get(name)
    measured: Estimate | Mapping[str, Any] | None = recorded
    has_interval = "mean_interval" in (recorded or {})
    if episodes and not has_interval:
        column = "length" if name == "length" else "total_reward"
        measured = estimate([float(getattr(episode, column)) for episode in episodes])
    if not measured:
        mean = record.summary.get(f"mean_{name}")
        return None if mean is None else Result(name, f"{number(float(mean))} {unit}".strip())
    values = measured if isinstance(measured, Mapping) else _fields(measured)
    if name == "return" and values["min"] == values["max"] == 0:
        return None  # a task without rewards
    return estimate_result(name, values, unit)


def _demonstrations(summary: Mapping[str, Any]) -> Result | None:
    if "successes" not in summary:
        return None
    count = int(summary["successes"])
    wanted = summary.get("successes_wanted")
    about = () if wanted is None else (f"of {wanted:,} that were asked for",)
    return Result(name="demonstrations", text=f"{count:,}", about=about, value=float(count))


def _training_time(summary: Mapping[str, Any]) -> Result | None:
    seconds = summary.get("train_seconds")
    steps = summary.get("env_steps")
    if seconds is None or not steps:
        return None
    about = (f"in {_duration(seconds)}", f"{steps / seconds:,.0f} steps/s") if seconds else ()
    return Result(name="environment steps", text=f"{steps:,}", about=about, value=float(steps))


def _duration(seconds: float) -> str:
    """``24 s``, ``3 min 20 s``, ``2 h 5 min``."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"
