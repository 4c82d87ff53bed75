"""Tables of results: of a run, a collection, a training, an evaluation, from their JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from embodichain.cli.terminal.output import number, result_number

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
        ("episodes", f"{episodes} ({_environments(summary['num_envs'])})"),
        ("control steps", f"{summary['control_steps']:,} in {summary['seconds']:.2f} s"),
        ("FPS", f"{summary['fps']:,.0f} environment steps/s"),
    ]
    if _has_return(summary):
        rows += _spread_row("return", summary["return"], summary["episodes"])
    rows += _spread_row("length", summary["length"], summary["episodes"])
    if summary["success_rate"] is not None:
        rows.append(("success", f"{summary['success_rate']:.1%}"))
    rows += _term_rows(summary, summary["success_rate"])
    for step, count in summary.get("failed_in", {}).items():
        rows.append((f"failed in: {step}", count))
        detail = summary["failed_for"][step].removeprefix(step).removeprefix(":").strip()
        if detail:
            rows.append(("for instance", detail))
    if summary["diverged"]:
        rows.append(("diverged", f"{summary['diverged']} episodes"))
    for term, steps in summary.get("not_finite", {}).items():
        rows.append((f"not finite: {term}", f"NaN or infinite in {steps:,} control steps"))
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


def _environments(count: int) -> str:
    """``1 environment``, ``1,024 environments``."""
    return f"{count:,} environment{'s' * (count != 1)}"


def _spread_row(name: str, spread: Mapping[str, float] | None, episodes: int) -> Rows:
    """The mean of a quantity over episodes, with its spread if there are several."""
    if spread is None:
        return []
    mean = result_number(spread["mean"])
    if episodes == 1:
        return [(name, mean)]
    low = result_number(spread["min"])
    high = result_number(spread["max"])
    text = f"{mean} ± {result_number(spread['std'])}"
    if low != high:
        text += f" ({low} to {high})"
    return [(name, text)]


def _term_rows(result: Mapping[str, Any], success_rate: float | None) -> Rows:
    """The means of metrics and rewards, of those that have one.

    The metric `success` is left out if its mean is the success rate, which has a row.
    """
    rows: Rows = []
    for name, value in result["metrics"].items():
        is_repeated = name == "success" and value == success_rate
        if value is not None and not is_repeated:
            rows.append((f"metric {name}", result_number(value)))
    for name, value in result["rewards"].items():
        if value is not None:
            rows.append((f"reward {name}", result_number(value)))
    return rows


def collection_rows(summary: Mapping[str, Any]) -> Rows:
    """Return the table that a collection prints, from the content of its `summary.json`."""
    ends = {
        "finished": "complete",
        "max_steps": "max_steps reached",
        "gave_up": "gave up: too many failures in a row",
        "interrupted": f"interrupted ({summary['signal']}); continue: resume={summary['folder']}",
    }
    rows: Rows = [
        ("ended", ends[summary["status"]]),
        ("successes", f"{summary['successes']:,} of {summary['successes_wanted']:,}"),
        ("failures", f"{summary['failures']:,}"),
    ]
    if summary["yield"] is not None:
        rows.append(("yield", f"{summary['yield']:.1%}"))
    rows.append(("successes a minute", f"{summary['episodes_per_minute']:,.0f}"))
    if summary["mean_length"] is not None:
        rows.append(("mean length", summary["mean_length"]))
    rows += [
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
        if key in ("task", "eval", "folder") or value is None:
            continue
        rows.append((key.replace("_", " "), _training_cell(key, value, summary)))
    if summary.get("eval") is not None:
        rows += brief_rows(summary["eval"])
    return rows


def _training_cell(key: str, value: Any, summary: Mapping[str, Any]) -> Any:
    """How the table of a training shows an entry of its `summary.json`."""
    if key == "time_fractions":
        return ", ".join(f"{name} {share:.0%}" for name, share in value.items())
    if key == "success_rate" or (key == "objective" and _has_success(summary)):
        return f"{value:.1%}"
    if key in ("env_steps", "episodes"):
        return f"{value:,}"
    if isinstance(value, float):
        return result_number(value)
    return value


def _has_success(summary: Mapping[str, Any]) -> bool:
    """Whether the objective of a training is a success rate, and not a return."""
    evaluation = summary.get("eval")
    if evaluation is not None:
        return evaluation["success"] is not None
    return summary.get("success_rate") is not None


def evaluation_rows(result: Mapping[str, Any]) -> Rows:
    """Return the table of an evaluation, from the content of its `eval.json`."""
    mode = "deterministic" if result["deterministic"] else "actions drawn"
    rows: Rows = [
        ("policy", f"{result['policy']} ({mode})"),
        ("episodes", f"{result['episodes']:,} of {_environments(result['num_envs'])}"),
    ]
    rows += _stage_row(result)
    rows += _success_row(result)
    rows += _estimate_rows("return", result["returns"])
    rows += _estimate_rows("length", result["length"])
    success = result["success"]
    rows += _term_rows(result, None if success is None else success["rate"])
    for name in ("terminated", "diverged"):
        rows.append((name, f"{result[name]:,} episode{'s' * (result[name] != 1)}"))
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
    """Mean, interquartile mean and median of a quantity over episodes; one row if all are equal."""
    if estimate is None:
        return []
    median = result_number(estimate["median"])
    low = result_number(estimate["min"])
    high = result_number(estimate["max"])
    if low == high:
        return [(name, median)]
    return [
        (f"{name} mean", _with_interval(estimate, "mean")),
        (f"{name} IQM", _with_interval(estimate, "iqm")),
        (f"{name} median", f"{median}  ({low} to {high})"),
    ]


def _with_interval(estimate: Mapping[str, Any], key: str) -> str:
    """A value with its confidence interval, if it has one."""
    value = result_number(estimate[key])
    interval = estimate[f"{key}_interval"]
    if interval is None:
        return value
    low, high = interval
    return f"{value}  [{result_number(low)}, {result_number(high)}]"
