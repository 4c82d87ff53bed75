"""What an evaluation found, as people read it. Knows nothing of how it came about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["brief_rows", "objective_of", "print_evaluation"]


def print_evaluation(result: Mapping[str, Any]) -> None:
    """Print the closing table of `eval`.

    Args:
        result: What `eval.json` holds.
    """
    from embodichain.cli.tables import print_facts

    mode = "deterministic" if result["deterministic"] else "actions drawn"
    rows: list[tuple[str, Any]] = [
        ("policy", f"{result['policy']} ({mode})"),
        ("episodes", f"{result['episodes']:,} of {result['num_envs']} environments"),
        *_success_row(result),
    ]
    for name, key in (("return", "returns"), ("length", "length")):
        rows += _estimate_rows(name, result[key])
    rows += [(f"reward {name}", value) for name, value in result["rewards"].items()]
    rows += [(f"metric {name}", value) for name, value in result["metrics"].items()]
    rows.append(("terminated", f"{result['terminated']} episodes"))
    rows.append(("diverged", f"{result['diverged']} episodes"))
    names = ("seed", "log", "video", "folder")
    rows += [(name, result[name]) for name in names if result.get(name) is not None]
    title = f"{result['task']}  ([low, high]: {result['confidence']:.0%} intervals)"
    print_facts(title, rows)


def brief_rows(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return what the closing table of a training says of its evaluation."""
    episodes = f"{result['episodes']:,} episodes  ([low, high]: {result['confidence']:.0%})"
    returns = _estimate_rows("return", result["returns"])[:2]
    rows = [("episodes", episodes), *_success_row(result), *returns]
    return [(f"eval {name}", value) for name, value in rows]


def objective_of(result: Mapping[str, Any]) -> float | None:
    """What a sweeper optimises: the success rate, or the mean return where there is none."""
    if result["success"] is not None:
        return float(result["success"]["rate"])
    return None if result["returns"] is None else float(result["returns"]["mean"])


def _success_row(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    success = result["success"]
    if success is None:
        return []
    low, high = success["interval"]
    share = f"{success['rate']:.1%}  [{low:.1%}, {high:.1%}]"
    return [("success", f"{share}  {success['count']} of {success['trials']}")]


def _estimate_rows(name: str, found: Mapping[str, Any] | None) -> list[tuple[str, Any]]:
    from embodichain.cli.tables import number

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
