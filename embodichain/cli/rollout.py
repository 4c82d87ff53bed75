"""The loop of `run`: act, step, count, show; and what came out of it, for `summary.json`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from embodichain.cli.output import number, print_facts
from embodichain.cli.process import StopFlag
from embodichain.cli.progress import ProgressDisplay
from embodichain.learning.episode_statistics import EpisodeStatistics, play

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.policies import Policy

__all__ = ["Outcome", "print_summary", "roll_out", "summarize"]

Status = Literal["finished", "max_steps", "interrupted"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a rollout ended.

    Attributes:
        status: ``finished``: every environment had its episodes; ``max_steps``: the limit came
            first; ``interrupted``: a signal did.
        statistics: What was counted.
        seconds: Wall time of the loop.
        signal: The signal's name, when interrupted.
    """

    status: Status
    statistics: EpisodeStatistics
    seconds: float
    signal: str | None = None

    @property
    def fps(self) -> float:
        """Environment steps a second: control steps times environments."""
        steps = self.statistics.steps * self.statistics.num_envs
        return steps / self.seconds if self.seconds > 0 else 0.0


def roll_out(
    env: BaseEnv,
    policy: Policy,
    obs: Any,
    episodes: int,
    max_steps: int | None,
    display: ProgressDisplay,
    stop: StopFlag,
) -> Outcome:
    """Step `env` with `policy` from `obs` until something ends it; no faster than a window shows.

    Args:
        env: A batched environment that was just reset; it resets its environments itself.
        policy: Acts; told when environments begin a new episode.
        obs: What the reset returned.
        episodes: How many count for each environment.
        max_steps: Most control steps, None for no limit.
        display: Shows how far it is.
        stop: Its flag ends the loop after a whole step.
    """
    statistics = EpisodeStatistics(env.num_envs, episodes)
    limit = float("inf") if max_steps is None else max_steps
    start = time.perf_counter()
    status: Status = "finished" if stop.stopped is None else "interrupted"
    for _ in play(env, policy, obs, statistics) if stop.stopped is None else ():
        if env.sim.is_window_open:  # for people who look on
            time.sleep(max(0.0, start + statistics.steps * env.step_dt - time.perf_counter()))
        if display.due:
            display.show(*_progress(statistics, max_steps, time.perf_counter() - start))
        if not statistics.complete and (stop.stopped is not None or statistics.steps >= limit):
            status = "interrupted" if stop.stopped is not None else "max_steps"
            break
    seconds = time.perf_counter() - start
    display.show(*_progress(statistics, max_steps, seconds))
    return Outcome(status, statistics, seconds, stop.stopped)


def _progress(
    statistics: EpisodeStatistics, max_steps: int | None, seconds: float
) -> tuple[int, dict[str, str]]:
    """How many episodes are done, and the facts beside the bar."""
    rate = statistics.steps * statistics.num_envs / seconds if seconds > 0 else 0.0
    steps = f"{statistics.steps}/{max_steps}" if max_steps is not None else f"{statistics.steps}"
    facts = {"step": steps, "FPS": f"{rate:,.0f}"}
    mean_return, success = statistics.mean("return"), statistics.mean("success")
    if mean_return:  # not 0 all along: the task pays something
        facts["return"] = f"{mean_return:.3g}"
    if success is not None:
        facts["success"] = f"{success:.0%}"
    return statistics.episodes, facts


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
