"""What a log costs: `python -m benchmarks.log_cost`.

Two equal environments in one process, one with a log, take turns next to each other, in random
order: a machine whose speed wanders wanders less from one turn to the next. Each case has some
processes of its own: of two environments that are the same the one or the other is faster by up to
1 %, as memory lies, for as long as they live. A turn is whole episodes, and ends when everything is
in the file: that wait of 12 to 40 ms, once a run, has to be little beside a turn.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import arms
from benchmarks.machine import table, write_json
from benchmarks.medians import sure
from benchmarks.rounds import EPISODE, timed

LIMITS: dict[tuple[int, int], float | None] = {
    (4, 4): None,
    (64, 4): 0.15,
    (1024, 4): 0.10,
    (1024, 1): 0.10,
    (1024, 10): 0.03,
}
"""Environments and physics steps a control step, and the share that a log may cost at most."""


def main() -> None:
    """Measure, print the table, write the raw figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--processes", type=int, default=6, help="one after another, of each case")
    parser.add_argument("--pairs", type=int, default=10, help="of one, at most; at least 2")
    parser.add_argument("--limit", type=float, default=50.0, help="seconds that one may take")
    parser.add_argument("--seconds", type=float, default=4.0, help="about how long a turn is")
    parser.add_argument("--episode", type=int, default=EPISODE, help="turns are multiples of it")
    parser.add_argument(
        "--case", type=int, nargs=2, action="append", metavar=("N", "STEPS"),
        help="environments and physics steps; default: all of them",
    )  # fmt: skip
    parser.add_argument("--here", action="store_true", help="the one case, in this process")
    parser.add_argument("--seed", type=int, default=0, help="of the order; odd: logged made first")
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    cases = [(n, steps) for n, steps in options.case] if options.case else list(LIMITS)
    if options.here:
        results = [measured(num_envs, steps, options) for num_envs, steps in cases]
    else:
        results = [pooled(num_envs, steps, options) for num_envs, steps in cases]
    facts = {"results": results}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def pooled(num_envs: int, steps: int, options: argparse.Namespace) -> dict[str, Any]:
    """A case, measured in several processes; the environment with a log is made first in half."""
    found = [measured_apart(num_envs, steps, options, k) for k in range(options.processes)]
    print(f"N={num_envs}, {steps} physics steps measured", flush=True)
    turns = [turn for one in found for turn in one["steps_a_turn"]]
    seconds = {
        name: [times for one in found for times in one["seconds"][name]]
        for name in ("plain", "logged")
    }
    return {"num_envs": num_envs, "physics_steps": steps, "steps_a_turn": turns, "seconds": seconds}


def measured_apart(
    num_envs: int, steps: int, options: argparse.Namespace, number: int
) -> dict[str, Any]:
    """A case, measured in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="log_cost-") as folder:
        out = Path(folder) / "case.json"
        command = [sys.executable, "-m", "benchmarks.log_cost", "--here", "--out", str(out)]
        command += ["--case", str(num_envs), str(steps), "--pairs", str(options.pairs)]
        command += ["--seconds", str(options.seconds), "--episode", str(options.episode)]
        command += ["--limit", str(options.limit), "--seed", str(number)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        (result,) = json.loads(out.read_text())["results"]
    found: dict[str, Any] = result
    return found


def measured(num_envs: int, steps: int, options: argparse.Namespace) -> dict[str, Any]:
    """Seconds a control step of both environments, one of each a pair: a list for this process."""
    order, override = random.Random(options.seed), f"task.sim_steps_per_control={steps}"
    made = [arms.make("random_reach", num_envs, override) for _ in range(2)]
    without, with_log = made[:: -1 if options.seed % 2 else 1]
    with tempfile.TemporaryDirectory(prefix="log_cost-") as folder:
        both = [
            arms.environment(without, "plain", "plain"),
            arms.recorded(with_log, "logged", "plain", Path(folder)),
        ]
        episode: int = options.episode
        plain, _ = (min(timed(arm, episode) for _ in range(2)) for arm in both)
        count = episode * max(1, round(options.seconds / plain))
        found: dict[str, list[float]] = {arm.name: [] for arm in both}
        end = time.monotonic() + options.limit
        for number in range(options.pairs):
            if time.monotonic() > end and number >= 2:
                break
            for arm in order.sample(both, 2):
                found[arm.name].append(timed(arm, count) / count)
        for arm in both:
            arm.close()
    seconds = {name: [times] for name, times in found.items()}
    return {
        "num_envs": num_envs, "physics_steps": steps, "steps_a_turn": [count], "seconds": seconds
    }  # fmt: skip


def report(facts: dict[str, Any]) -> str:
    """A Markdown table: medians over the pairs, how sure they are, and those of each process."""
    rows = []
    for found in facts["results"]:
        plain, logged = found["seconds"]["plain"], found["seconds"]["logged"]
        apart = [
            [b / a - 1 for a, b in zip(*one, strict=True)]
            for one in zip(plain, logged, strict=True)
        ]
        costs = sorted(chain.from_iterable(apart))
        cost, (low, high) = median(costs), sure(costs)
        medians = [median(one) for one in apart]
        limit = LIMITS.get((found["num_envs"], found["physics_steps"]))
        verdict = "" if limit is None else f"{limit:.0%}, {'met' if cost <= limit else 'missed'}"
        rows.append([
            found["num_envs"],
            found["physics_steps"],
            f"{1e6 * median(chain.from_iterable(plain)):.0f} us",
            f"**{cost:.1%}** [{low:.1%} to {high:.1%}]",
            f"{min(medians):.1%} to {max(medians):.1%}",
            verdict,
        ])  # fmt: skip
    heads = ["N", "physics steps", "a step without", "cost", "single processes", "at most"]
    return table(heads, rows)


if __name__ == "__main__":
    main()
