"""CPU time of commands to their first step, or their answer: `python -m benchmarks.startup`.

Every process runs on one thread. The figure to keep small is the ratio of a run's start to
`python -c "import torch"` of the same round, which every use of torch takes.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.machine import table, write_json

# A policy that ends the process when it is asked for the second time: the first step has returned.
# Nothing else is patched or imported early, so the order of imports is a user's.
FIRST_STEP = """
import os

def policy(obs, env):
    if env.control_step:
        os._exit(17)
    return env.robot.get_qpos()
"""
REACHED = 17
TORCH = "python -c 'import torch'"
RUN = "embodichain run, to its first step"
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}


def main() -> None:
    """Measure every command in turns and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cold", action="store_true", help="without a first round to warm up")
    parser.add_argument("--task", default="random_reach")
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    options = parser.parse_args()
    python = sys.executable
    with tempfile.TemporaryDirectory(prefix="startup-") as folder:
        (Path(folder) / "first_step.py").write_text(FIRST_STEP, encoding="utf-8")
        run = [f"task={options.task}", "num_envs=4", "policy=first_step:policy"]
        embodichain = [python, "-m", "embodichain"]
        commands = {
            "python -c pass": [python, "-c", "pass"],
            TORCH: [python, "-c", "import torch"],
            RUN: [*embodichain, "run", *run, "record=none", "sim.num_threads=1"],
            f"{RUN}, with a log": [*embodichain, "run", *run, "sim.num_threads=1"],
            "embodichain list tasks": [*embodichain, "list", "tasks"],
            "embodichain --help": [*embodichain, "--help"],
        }
        seconds = measure(commands, options.rounds, folder, options.cold)
    facts = {"rounds": options.rounds, "task": options.task, "cpu_seconds": seconds}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def report(facts: dict[str, Any]) -> str:
    """A Markdown table of CPU seconds, and of ratios to importing torch in the same round."""
    seconds = facts["cpu_seconds"]
    rows = []
    for name, times in seconds.items():
        ratios = [a / b for a, b in zip(times, seconds[TORCH], strict=True)]
        spread = f"{min(times):.2f} to {max(times):.2f}"
        rows.append([name, f"{median(times):.2f}", spread, f"{median(ratios):.2f}"])
    return table(["command", "CPU s, median", "spread", "over torch"], rows)


def measure(
    commands: dict[str, list[str]], rounds: int, folder: str | Path, cold: bool = False
) -> dict[str, list[float]]:
    """CPU seconds of every command in every round, after one that warms the disk's cache."""
    order = random.Random(0)
    seconds: dict[str, list[float]] = {name: [] for name in commands}
    environment = {**os.environ, **ONE_THREAD}
    for number in range(cold, rounds + 1):
        for name in order.sample(list(commands), len(commands)):
            before = os.times()
            done = subprocess.run(
                commands[name],
                capture_output=True,
                text=True,
                check=False,
                cwd=folder,
                env=environment,
            )
            after = os.times()
            if done.returncode not in (0, REACHED):
                raise RuntimeError(f"{name}: {done.stderr}")
            if number:
                user = after.children_user - before.children_user
                seconds[name].append(user + after.children_system - before.children_system)
    return seconds


if __name__ == "__main__":
    main()
