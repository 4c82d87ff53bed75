"""What a log costs: `python -m benchmarks.log_cost`.

Two equal environments in one process, one with a log, take turns next to each other, in random
order: a machine whose speed wanders wanders less from one turn to the next. A turn is whole
episodes, and ends when everything is in the file. With *lockstep* resets all environments are
reset in the same step; with *staggered* ones their episodes begin one after the other, as in every
task with terminations.
"""

from __future__ import annotations

import argparse
import random
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from benchmarks import arms
from benchmarks.machine import table, write_json
from benchmarks.medians import sure
from benchmarks.rounds import EPISODE
from embodichain.lab.sim.engine.cpu.mujoco_process import stop_timers

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

RESETS = ("lockstep", "staggered")


class Limit(NamedTuple):
    """The most that a log may cost; None is no limit.

    Attributes:
        share: Of a control step's time.
        us: Microseconds of CPU time a control step.
        nbytes: Bytes an environment and control step.
    """

    share: float | None = None
    us: float | None = None
    nbytes: float | None = None


LIMITS = {
    (4, 4): Limit(us=30, nbytes=280),
    (64, 4): Limit(0.20, nbytes=200),
    (1024, 4): Limit(0.08, nbytes=225),
    (1024, 1): Limit(0.20),
    (1024, 10): Limit(0.04),
}
"""Environments and physics steps a control step, and what a log may cost."""


def main() -> None:
    """Measure, print the table, write the raw figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=20, help="of turns, at most; at least 2")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds a case may take")
    parser.add_argument("--seconds", type=float, default=1.5, help="about how long a turn is")
    parser.add_argument("--episode", type=int, default=EPISODE, help="turns are multiples of it")
    parser.add_argument("--resets", choices=RESETS, action="append", help="default: both")
    parser.add_argument(
        "--case", type=int, nargs=2, action="append", metavar=("N", "STEPS"),
        help="environments and physics steps; default: all of them",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    cases = [(n, steps) for n, steps in options.case] if options.case else list(LIMITS)
    results = [
        measured(num_envs, steps, resets, options)
        for num_envs, steps in cases
        for resets in options.resets or RESETS
    ]
    facts = {"results": results}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def measured(num_envs: int, steps: int, resets: str, options: argparse.Namespace) -> dict[str, Any]:
    """Wall and CPU seconds a control step of both environments in each pair, and bytes of it."""
    order = random.Random(num_envs + steps)
    override = f"task.sim_steps_per_control={steps}"
    made = [arms.make("random_reach", num_envs, override) for _ in range(2)]
    with tempfile.TemporaryDirectory(prefix="log_cost-") as folder:
        both = [
            arms.environment(made[0], "plain", "plain"),
            arms.recorded(made[1], "logged", "plain", Path(folder)),
        ]
        if resets == "staggered":
            for env, arm in zip(made, both, strict=True):
                _stagger(env, arm, options.episode)
        (log,) = Path(folder).glob("*.mcap")
        one = max(timed(arm, options.episode)[0] for arm in both)
        count = options.episode * max(1, round(options.seconds / one / options.episode))
        wall: dict[str, list[float]] = {"plain": [], "logged": []}
        cpu: dict[str, list[float]] = {"plain": [], "logged": []}
        nbytes = []
        end = time.monotonic() + options.limit
        for number in range(options.pairs):
            if time.monotonic() > end and number >= 2:
                break
            before = log.stat().st_size
            for arm in order.sample(both, 2):
                seconds, busy = timed(arm, count)
                wall[arm.name].append(seconds)
                cpu[arm.name].append(busy)
            nbytes.append((log.stat().st_size - before) / (count * num_envs))
        for arm in both:
            arm.close()
    return {
        "num_envs": num_envs, "physics_steps": steps, "resets": resets, "steps_a_turn": count,
        "seconds": wall, "cpu_seconds": cpu, "bytes": nbytes,
    }  # fmt: skip


def _stagger(env: BaseEnv, arm: arms.Arm, episode: int) -> None:
    """Step for an episode, and reset each environment at another moment of it."""
    moments = np.arange(env.num_envs) * episode // env.num_envs
    for step in range(episode):
        ids = np.flatnonzero(moments == step)
        if len(ids):
            env.reset(options={"reset_ids": ids.tolist()})
        arm.step(step)


def timed(arm: arms.Arm, steps: int) -> tuple[float, float]:
    """Seconds a control step by the clock, and of CPU time in all threads."""
    stop_timers()
    wall, cpu = time.perf_counter(), time.process_time()
    for step in range(steps):
        arm.step(step)
    arm.finish()
    return (time.perf_counter() - wall) / steps, (time.process_time() - cpu) / steps


def report(facts: dict[str, Any]) -> str:
    """A Markdown table: medians over the pairs, and where they lie with 90 %."""
    rows = []
    for found in facts["results"]:
        costs = _shares(found["seconds"])
        cost, (low, high) = median(costs), sure(costs)
        cpu, nbytes = found["cpu_seconds"], median(found["bytes"])
        us = 1e6 * median(b - a for a, b in zip(cpu["plain"], cpu["logged"], strict=True))
        limit = LIMITS.get((found["num_envs"], found["physics_steps"]), Limit())
        rows.append([
            found["num_envs"],
            found["physics_steps"],
            found["resets"],
            f"{1e6 * median(found['seconds']['plain']):.0f} us",
            f"**{cost:.1%}** [{low:.1%} to {high:.1%}]{_verdict(cost, limit.share, '.0%')}",
            f"{median(_shares(cpu)):.1%}",
            f"{us:.0f} us{_verdict(us, limit.us, '.0f')}",
            f"{nbytes:.0f}{_verdict(nbytes, limit.nbytes, '.0f')}",
        ])  # fmt: skip
    heads = ["N", "physics steps", "resets", "a step without", "cost by the clock", "in CPU time"]
    return table([*heads, "CPU a step", "bytes an environment and step"], rows)


def _shares(seconds: dict[str, list[float]]) -> list[float]:
    return sorted(b / a - 1 for a, b in zip(seconds["plain"], seconds["logged"], strict=True))


def _verdict(value: float, most: float | None, form: str) -> str:
    if most is None:
        return ""
    return f", at most {most:{form}}: {'met' if value <= most else 'missed'}"


if __name__ == "__main__":
    main()
