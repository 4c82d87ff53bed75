"""Tables of results: of a run, a collection, a training, an evaluation, from their JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from embodichain.cli.terminal.output import number

__all__ = ["brief_rows", "collection_rows", "evaluation_rows", "run_rows", "training_rows"]


def run_rows(summary: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the table that a run prints, from the content of its `summary.json`."""
    ends = {
        "finished": "every environment had its episodes",
        "max_steps": "max_steps reached",
        "interrupted": f"interrupted ({summary['signal']})",
    }
    episodes = f"{summary['episodes']:,} of {summary['episodes_wanted']:,}"
    returns = summary["return"]
    has_return = summary["rewards"] or returns is None or returns["min"] < 0 or returns["max"] > 0
    rows: list[tuple[str, Any]] = [
        ("ended", ends[summary["status"]]),
        ("episodes", f"{episodes} ({summary['num_envs']} environments)"),
        ("control steps", f"{summary['control_steps']:,} in {summary['seconds']:.2f} s"),
        ("FPS", f"{summary['fps']:,.0f} environment steps/s"),
        *([("return", _mean_spread(returns))] if has_return else []),
        ("length", _mean_spread(summary["length"])),
    ]
    if summary["success_rate"] is not None:
        rows.append(("success", f"{summary['success_rate']:.1%}"))
    rows += [(f"metric {name}", value) for name, value in summary["metrics"].items()]
    rows += [(f"reward {name}", value) for name, value in summary["rewards"].items()]
    for step, count in summary.get("failed_in", {}).items():
        rows.append((f"failed in: {step}", count))
        detail = summary["failed_for"][step].removeprefix(step).removeprefix(":").strip()
        rows += [("for instance", detail)] if detail else []
    if summary["diverged"]:
        rows.append(("diverged", f"{summary['diverged']} episodes"))
    names = ("seed", "log", "video", "folder")
    return [*rows, *((name, summary[name]) for name in names if summary.get(name) is not None)]


def _mean_spread(spread: dict[str, float] | None) -> str:
    if spread is None:
        return "-"
    low, high = number(spread["min"]), number(spread["max"])
    return f"{number(spread['mean'])} ± {number(spread['std'])} ({low} to {high})"


def collection_rows(summary: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the table that a collection prints, from the content of its `summary.json`."""
    ends = {
        "finished": "complete",
        "max_steps": "max_steps reached",
        "gave_up": "gave up: too many failures in a row",
        "interrupted": f"interrupted ({summary['signal']}); continue: resume={summary['folder']}",
    }
    share = summary["yield"]
    rows: list[tuple[str, Any]] = [
        ("ended", ends[summary["status"]]),
        ("successes", f"{summary['successes']:,} of {summary['successes_wanted']:,}"),
        ("failures", f"{summary['failures']:,}"),
        ("yield", None if share is None else f"{share:.1%}"),
        ("successes a minute", f"{summary['episodes_per_minute']:,.0f}"),
        ("mean length", summary["mean_length"]),
        ("control steps", f"{summary['control_steps']:,} in {summary['seconds']:.2f} s"),
        ("FPS", f"{summary['fps']:,.0f} environment steps/s"),
        *((f"failed in: {step}", count) for step, count in summary["failed_in"].items()),
    ]
    names = ("policy", "seed", "video", "folder")
    return rows + [(name, summary[name]) for name in names if summary.get(name) is not None]


def training_rows(summary: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the table that a training prints, from the content of its `summary.json`."""
    shares = [f"{name} {share:.0%}" for name, share in summary["time_fractions"].items()]
    rows = [
        (key.replace("_", " "), shares if key == "time_fractions" else value)
        for key, value in summary.items()
        if key not in ("task", "eval", "folder")
    ]
    return rows + (brief_rows(summary["eval"]) if summary.get("eval") is not None else [])


def evaluation_rows(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the table of an evaluation, from the content of its `eval.json`."""
    mode = "deterministic" if result["deterministic"] else "actions drawn"
    rows: list[tuple[str, Any]] = [
        ("policy", f"{result['policy']} ({mode})"),
        ("episodes", f"{result['episodes']:,} of {result['num_envs']} environments"),
        *_stage_row(result),
        *_success_row(result),
        *_estimate_rows("return", result["returns"]),
        *_estimate_rows("length", result["length"]),
    ]
    rows += [(f"reward {name}", value) for name, value in result["rewards"].items()]
    rows += [(f"metric {name}", value) for name, value in result["metrics"].items()]
    rows += [(name, f"{result[name]} episodes") for name in ("terminated", "diverged")]
    names = ("seed", "log", "video", "folder")
    return rows + [(name, result[name]) for name in names if result.get(name) is not None]


def brief_rows(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the rows about the evaluation for the final table of a training."""
    episodes = f"{result['episodes']:,} episodes  ([low, high]: {result['confidence']:.0%})"
    returns = _estimate_rows("return", result["returns"])[:2]
    rows = [("episodes", episodes), *_stage_row(result), *_success_row(result), *returns]
    return [(f"eval {name}", value) for name, value in rows]


def _stage_row(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """At which stage of its curriculum the task was judged; older files do not say."""
    stage = result.get("curriculum")
    if stage is None:
        return []
    where = "of the training" if stage["training"] else "of this task, not of a training"
    values = "".join(f", {name} {number(value)}" for name, value in stage["values"].items())
    return [("curriculum", f"control step {stage['control_step']:,} {where}{values}")]


def _success_row(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    success = result["success"]
    if success is None:
        return []
    low, high = success["interval"]
    share = f"{success['rate']:.1%}  [{low:.1%}, {high:.1%}]"
    return [("success", f"{share}  {success['count']} of {success['trials']}")]


def _estimate_rows(name: str, found: Mapping[str, Any] | None) -> list[tuple[str, Any]]:
    if found is None:
        return [(name, None)]

    def spread(key: str) -> str:
        interval = found[f"{key}_interval"]
        ends = f"  [{number(interval[0])}, {number(interval[1])}]" if interval is not None else ""
        return f"{number(found[key])}{ends}"

    whole = f"{number(found['min'])} to {number(found['max'])}"
    return [
        (f"{name} mean", spread("mean")),
        (f"{name} IQM", spread("iqm")),
        (f"{name} median", f"{number(found['median'])}  ({whole})"),
    ]
