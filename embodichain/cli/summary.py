"""What a rollout was, as plain data for `summary.json` and `--json`, and as the closing table."""

from __future__ import annotations

from typing import Any

from embodichain.cli.rollout import Outcome
from embodichain.cli.tables import number, print_facts
from embodichain.learning.episode_statistics import EpisodeStatistics

__all__ = ["print_summary", "summarize"]


def summarize(outcome: Outcome, facts: dict[str, Any]) -> dict[str, Any]:
    """Return everything worth keeping about a rollout.

    Args:
        outcome: How it ended.
        facts: What the caller knows: task, seed, folder, log, ...; stands first.
    """
    counted = outcome.statistics
    return {
        **facts,
        "status": outcome.status,
        "signal": outcome.signal,
        "num_envs": counted.num_envs,
        "control_steps": counted.steps,
        "env_steps": counted.steps * counted.num_envs,
        "seconds": round(outcome.seconds, 6),
        "fps": round(outcome.fps, 3),
        "episodes": counted.episodes,
        "episodes_wanted": counted.wanted,
        "return": _spread(counted, "return"),
        "length": _spread(counted, "length"),
        "success_rate": counted.mean("success"),
        "terminated": _count(counted, "terminated"),
        "diverged": _count(counted, "diverged"),
        "metrics": _means(counted, "metrics/"),
        "rewards": _means(counted, "rewards/"),
    }


def print_summary(summary: dict[str, Any]) -> None:
    """Print the closing table."""
    episodes = f"{summary['episodes']:,} of {summary['episodes_wanted']:,}"
    rows: list[tuple[str, Any]] = [
        ("ended", _ended(summary)),
        ("episodes", f"{episodes} ({summary['num_envs']} environments)"),
        ("control steps", f"{summary['control_steps']:,} in {summary['seconds']:.2f} s"),
        ("FPS", f"{summary['fps']:,.0f} environment steps/s"),
        *([("return", _mean_spread(summary["return"]))] if _pays(summary) else []),
        ("length", _mean_spread(summary["length"])),
    ]
    if summary["success_rate"] is not None:
        rows.append(("success", f"{summary['success_rate']:.1%}"))
    rows += [(f"metric {name}", value) for name, value in summary["metrics"].items()]
    rows += [(f"reward {name}", value) for name, value in summary["rewards"].items()]
    if summary["diverged"]:
        rows.append(("diverged", f"{summary['diverged']} episodes"))
    names = ("seed", "log", "video", "folder")
    rows += [(name, summary[name]) for name in names if summary.get(name) is not None]
    print_facts(str(summary["task"]), rows)


def _ended(summary: dict[str, Any]) -> str:
    texts = {
        "finished": "every environment had its episodes",
        "max_steps": "max_steps reached",
        "interrupted": f"interrupted ({summary['signal']})",
    }
    return texts[summary["status"]]


def _pays(summary: dict[str, Any]) -> bool:
    """Whether there is a return to speak of: a task without rewards always returns 0."""
    spread = summary["return"]
    return bool(summary["rewards"]) or spread is None or spread["min"] < 0 or spread["max"] > 0


def _spread(counted: EpisodeStatistics, name: str) -> dict[str, float] | None:
    column = counted.column(name)
    if not column.size:
        return None
    names = ("mean", "std", "min", "max")
    return {name: float(getattr(column, name)()) for name in names}


def _mean_spread(spread: dict[str, float] | None) -> str:
    if spread is None:
        return "-"
    low, high = number(spread["min"]), number(spread["max"])
    return f"{number(spread['mean'])} ± {number(spread['std'])} ({low} to {high})"


def _count(counted: EpisodeStatistics, name: str) -> int:
    return int(counted.column(name).sum())


def _means(counted: EpisodeStatistics, prefix: str) -> dict[str, float | None]:
    names = [name for name in counted.names() if name.startswith(prefix)]
    return {name.removeprefix(prefix): counted.mean(name) for name in names}
