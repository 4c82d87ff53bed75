"""What a log costs: `python -m benchmarks.log_cost`.

Two equal environments in one process, one with a log, take turns next to each other, in random
order: a machine whose speed wanders wanders less from one turn to the next. Each case has a process
of its own. A turn is whole episodes, and ends when everything is in the file: that wait of 10 to 20
ms, once a run, has to be little beside a turn.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
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
    parser.add_argument("--pairs", type=int, default=60, help="at most; at least a fifth of it")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds that a case may take")
    parser.add_argument("--seconds", type=float, default=4.0, help="about how long a turn is")
    parser.add_argument("--episode", type=int, default=EPISODE, help="turns are multiples of it")
    parser.add_argument(
        "--case", type=int, nargs=2, action="append", metavar=("N", "STEPS"),
        help="environments and physics steps; default: all of them",
    )  # fmt: skip
    parser.add_argument("--here", action="store_true", help="the one case, in this process")
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    cases = [(n, steps) for n, steps in options.case] if options.case else list(LIMITS)
    if options.here:
        results = [measured(num_envs, steps, options) for num_envs, steps in cases]
    else:
        results = [measured_apart(num_envs, steps, options) for num_envs, steps in cases]
    facts = {"results": results}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def measured_apart(num_envs: int, steps: int, options: argparse.Namespace) -> dict[str, Any]:
    """A case, measured in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="log_cost-") as folder:
        out = Path(folder) / "case.json"
        command = [sys.executable, "-m", "benchmarks.log_cost", "--here", "--out", str(out)]
        command += ["--case", str(num_envs), str(steps), "--pairs", str(options.pairs)]
        command += ["--seconds", str(options.seconds), "--episode", str(options.episode)]
        command += ["--limit", str(options.limit)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        (result,) = json.loads(out.read_text())["results"]
    print(f"N={num_envs}, {steps} physics steps measured", flush=True)
    found: dict[str, Any] = result
    return found


def measured(num_envs: int, steps: int, options: argparse.Namespace) -> dict[str, Any]:
    """Seconds a control step of both environments, one of each a pair."""
    order, override = random.Random(0), f"task.sim_steps_per_control={steps}"
    without, with_log = (arms.make("random_reach", num_envs, override) for _ in range(2))
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
            if time.monotonic() > end and number >= options.pairs / 5:
                break
            for arm in order.sample(both, 2):
                found[arm.name].append(timed(arm, count) / count)
        for arm in both:
            arm.close()
    return {"num_envs": num_envs, "physics_steps": steps, "steps_a_turn": count, "seconds": found}


def report(facts: dict[str, Any]) -> str:
    """A Markdown table: medians over the pairs, and how sure they are."""
    rows = []
    for found in facts["results"]:
        plain, logged = found["seconds"]["plain"], found["seconds"]["logged"]
        costs = sorted(b / a - 1 for a, b in zip(plain, logged, strict=True))
        cost, (low, high) = median(costs), sure(costs)
        limit = LIMITS.get((found["num_envs"], found["physics_steps"]))
        verdict = "" if limit is None else f"{limit:.0%}, {'met' if cost <= limit else 'missed'}"
        quarter = len(costs) // 4
        rows.append([
            found["num_envs"],
            found["physics_steps"],
            f"{1e6 * median(plain):.0f} us",
            f"**{cost:.1%}** [{low:.1%} to {high:.1%}]",
            f"{costs[quarter]:.1%} to {costs[-1 - quarter]:.1%}",
            verdict,
        ])  # fmt: skip
    heads = ["N", "physics steps", "a step without", "cost", "half of the pairs", "at most"]
    return table(heads, rows)


if __name__ == "__main__":
    main()
