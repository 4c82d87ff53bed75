"""Tables of results: of a run, a collection, a training, an evaluation, from their JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from embodichain.cli.terminal.output import number

__all__ = [
    "brief_rows",
    "collection_rows",
    "evaluation_rows",
    "result_rows",
    "run_rows",
    "training_rows",
]

Rows = list[tuple[str, Any]]


def result_rows(summary: Mapping[str, Any], evaluation: Mapping[str, Any]) -> Rows:
    """Return the table that the command of a run printed, without rewards.

    Args:
        summary: The content of its `summary.json`; empty without it.
        evaluation: The content of its `eval.json`; empty without it.
    """
    if summary.get("status") == "failed":
        rows = list(summary.items())
    elif "algo" in summary:
        rows = training_rows(summary)
    elif "successes_wanted" in summary:
        rows = collection_rows(summary)
    elif summary:
        rows = run_rows(summary)
    elif evaluation:
        rows = evaluation_rows(evaluation)
    else:
        rows = []
    return [(name, value) for name, value in rows if not name.startswith("reward ")]


def run_rows(summary: Mapping[str, Any]) -> Rows:
    """Return the table that a run prints, from the content of its `summary.json`."""
    ends = {
        "finished": "every environment had its episodes",
        "max_steps": "max_steps reached",
        "interrupted": f"interrupted ({summary['signal']})",
    }
    episodes = f"{summary['episodes']:,} of {summary['episodes_wanted']:,}"
    rows: Rows = [
        ("ended", ends[summary["status"]]),
        ("episodes", f"{episodes} ({summary['num_envs']} environments)"),
        ("control steps", f"{summary['control_steps']:,} in {summary['seconds']:.2f} s"),
        ("FPS", f"{summary['fps']:,.0f} environment steps/s"),
    ]
    if _has_return(summary):
        rows.append(("return", _mean_spread(summary["return"])))
    rows.append(("length", _mean_spread(summary["length"])))
    if summary["success_rate"] is not None:
        rows.append(("success", f"{summary['success_rate']:.1%}"))
    rows += [(f"metric {name}", value) for name, value in summary["metrics"].items()]
    rows += [(f"reward {name}", value) for name, value in summary["rewards"].items()]
    for step, count in summary.get("failed_in", {}).items():
        rows.append((f"failed in: {step}", count))
        detail = summary["failed_for"][step].removeprefix(step).removeprefix(":").strip()
        if detail:
            rows.append(("for instance", detail))
    if summary["diverged"]:
        rows.append(("diverged", f"{summary['diverged']} episodes"))
    rows += _present(summary, ("seed", "log", "video", "folder"))
    return rows


def _has_return(summary: Mapping[str, Any]) -> bool:
    """Whether the task has rewards: a class's own rewards have no names, but are not all 0."""
    returns = summary["return"]
    if summary["rewards"] or returns is None:
        return True
    return returns["min"] < 0 or returns["max"] > 0


def _present(result: Mapping[str, Any], names: Iterable[str]) -> Rows:
    """The entries of a result that it has."""
    return [(name, result[name]) for name in names if result.get(name) is not None]


def _mean_spread(spread: dict[str, float] | None) -> str:
    if spread is None:
        return "-"
    low = number(spread["min"])
    high = number(spread["max"])
    return f"{number(spread['mean'])} ± {number(spread['std'])} ({low} to {high})"


def collection_rows(summary: Mapping[str, Any]) -> Rows:
    """Return the table that a collection prints, from the content of its `summary.json`."""
    ends = {
        "finished": "complete",
        "max_steps": "max_steps reached",
        "gave_up": "gave up: too many failures in a row",
        "interrupted": f"interrupted ({summary['signal']}); continue: resume={summary['folder']}",
    }
    success_share = summary["yield"]
    rows: Rows = [
        ("ended", ends[summary["status"]]),
        ("successes", f"{summary['successes']:,} of {summary['successes_wanted']:,}"),
        ("failures", f"{summary['failures']:,}"),
        ("yield", None if success_share is None else f"{success_share:.1%}"),
        ("successes a minute", f"{summary['episodes_per_minute']:,.0f}"),
        ("mean length", summary["mean_length"]),
        ("control steps", f"{summary['control_steps']:,} in {summary['seconds']:.2f} s"),
        ("FPS", f"{summary['fps']:,.0f} environment steps/s"),
    ]
    rows += [(f"failed in: {step}", count) for step, count in summary["failed_in"].items()]
    rows += _present(summary, ("policy", "seed", "video", "folder"))
    return rows


def training_rows(summary: Mapping[str, Any]) -> Rows:
    """Return the table that a training prints, from the content of its `summary.json`."""
    rows: Rows = []
    for key, value in summary.items():
        if key in ("task", "eval", "folder"):
            continue
        cell = value
        if key == "time_fractions":
            cell = [f"{name} {share:.0%}" for name, share in value.items()]
        elif key == "success_rate" and value is not None:
            cell = f"{value:.1%}"
        rows.append((key.replace("_", " "), cell))
    if summary.get("eval") is not None:
        rows += brief_rows(summary["eval"])
    return rows


def evaluation_rows(result: Mapping[str, Any]) -> Rows:
    """Return the table of an evaluation, from the content of its `eval.json`."""
    mode = "deterministic" if result["deterministic"] else "actions drawn"
    rows: Rows = [
        ("policy", f"{result['policy']} ({mode})"),
        ("episodes", f"{result['episodes']:,} of {result['num_envs']} environments"),
    ]
    rows += _stage_row(result)
    rows += _success_row(result)
    rows += _estimate_rows("return", result["returns"])
    rows += _estimate_rows("length", result["length"])
    rows += [(f"reward {name}", value) for name, value in result["rewards"].items()]
    rows += [(f"metric {name}", value) for name, value in result["metrics"].items()]
    rows += [(name, f"{result[name]} episodes") for name in ("terminated", "diverged")]
    rows += _present(result, ("seed", "log", "video", "folder"))
    return rows


def brief_rows(result: Mapping[str, Any]) -> Rows:
    """Return the rows about the evaluation for the final table of a training."""
    episodes = f"{result['episodes']:,} episodes  ([low, high]: {result['confidence']:.0%})"
    mean_and_iqm = _estimate_rows("return", result["returns"])[:2]
    rows = [("episodes", episodes), *_stage_row(result), *_success_row(result), *mean_and_iqm]
    return [(f"eval {name}", value) for name, value in rows]


def _stage_row(result: Mapping[str, Any]) -> Rows:
    """The stage of its curriculum in which the task was evaluated; older files have none."""
    stage = result.get("curriculum")
    if stage is None:
        return []
    where = "of the training" if stage["training"] else "of this task, not of a training"
    values = "".join(f", {name} {number(value)}" for name, value in stage["values"].items())
    return [("curriculum", f"control step {stage['control_step']:,} {where}{values}")]


def _success_row(result: Mapping[str, Any]) -> Rows:
    success = result["success"]
    if success is None:
        return []
    low, high = success["interval"]
    share = f"{success['rate']:.1%}  [{low:.1%}, {high:.1%}]"
    return [("success", f"{share}  {success['count']} of {success['trials']}")]


def _estimate_rows(name: str, estimate: Mapping[str, Any] | None) -> Rows:
    """Mean, interquartile mean and median of a quantity over episodes."""
    if estimate is None:
        return [(name, None)]
    value_range = f"{number(estimate['min'])} to {number(estimate['max'])}"
    return [
        (f"{name} mean", _with_interval(estimate, "mean")),
        (f"{name} IQM", _with_interval(estimate, "iqm")),
        (f"{name} median", f"{number(estimate['median'])}  ({value_range})"),
    ]


def _with_interval(estimate: Mapping[str, Any], key: str) -> str:
    """A value with its confidence interval, if it has one."""
    value = number(estimate[key])
    interval = estimate[f"{key}_interval"]
    if interval is None:
        return value
    low, high = interval
    return f"{value}  [{number(low)}, {number(high)}]"
