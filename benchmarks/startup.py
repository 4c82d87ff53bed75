"""How long a command takes to its first step, or its answer: `python -m benchmarks.startup`.

The figure to keep small is the run's time beyond `python -c "import torch"`, which nobody escapes.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
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
BEYOND = "first step, beyond torch"


def main() -> None:
    """Measure every command in turns and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    options = parser.parse_args()
    python = sys.executable
    with tempfile.TemporaryDirectory(prefix="startup-") as folder:
        (Path(folder) / "first_step.py").write_text(FIRST_STEP, encoding="utf-8")
        run = ["run", "task=random_reach", "num_envs=4", "policy=first_step:policy"]
        commands = {
            "python -c pass": [python, "-c", "pass"],
            "python -c 'import torch'": [python, "-c", "import torch"],
            "embodichain run, to its first step": [python, "-m", "embodichain", *run],
            "embodichain list tasks": [python, "-m", "embodichain", "list", "tasks"],
            "embodichain --help": [python, "-m", "embodichain", "--help"],
        }
        seconds = measure(commands, options.rounds, folder)
    torch, first = (seconds[name] for name in list(commands)[1:3])
    seconds[BEYOND] = [b - a for a, b in zip(torch, first, strict=True)]
    facts = {"rounds": options.rounds, "seconds": seconds}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def report(facts: dict[str, Any]) -> str:
    """A Markdown table of wall seconds."""
    rows = [
        [name, f"{median(times):.2f}", f"{min(times):.2f} to {max(times):.2f}"]
        for name, times in facts["seconds"].items()
    ]
    return table(["command", "s, median", "spread"], rows)


def measure(
    commands: dict[str, list[str]], rounds: int, folder: str | Path
) -> dict[str, list[float]]:
    """Wall seconds of every command in every round; a first round only warms the disk's cache."""
    order = random.Random(0)
    seconds: dict[str, list[float]] = {name: [] for name in commands}
    for number in range(rounds + 1):
        for name in order.sample(list(commands), len(commands)):
            start = time.perf_counter()
            done = subprocess.run(
                commands[name], capture_output=True, text=True, check=False, cwd=folder
            )
            taken = time.perf_counter() - start
            if done.returncode not in (0, REACHED):
                raise RuntimeError(f"{name}: {done.stderr}")
            if number:
                seconds[name].append(taken)
    return seconds


if __name__ == "__main__":
    main()
