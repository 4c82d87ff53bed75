"""Where a step of random_reach goes: `python -m benchmarks.step_profile`.

Parts of `BaseEnv.step` are replaced by timed ones on the instance. A timer costs about 0.15 us a
part, which shows in the difference between the sum and the step measured without timers.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import arms
from benchmarks.machine import table, write_json

SIZES = (1, 8, 64, 1024)
PARTS = {
    "check the action": ("_check_action",),
    "action terms, write targets": ("_act",),
    "physics": ("sim", "update"),
    "hook after physics": ("_update_sim_state",),
    "terminations, metrics, info": ("_judge", "_outcome"),
    "rewards": ("_judge", "_reward"),
    "time limits": ("episodes", "take_truncated"),
    "events": ("event_manager", "step"),
    "commands": ("command_manager", "step"),
    "observation": ("_step_observation", "_observe"),
    "divergence": ("_judge", "diverged"),
    "automatic resets": ("_autoreset",),
}
"""What is timed, in the order of a step, and where it hangs on the environment."""
REST, WHOLE = "the rest of step()", "step(), without timers"


def main() -> None:
    """Measure every size and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="random_reach")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=0.3)
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    options = parser.parse_args()
    found = {
        size: profile(options.task, size, options.rounds, options.seconds) for size in options.sizes
    }
    facts = {"task": options.task, "rounds": options.rounds, "microseconds": found}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def report(facts: dict[str, Any]) -> str:
    """A Markdown table: parts by size.

    The parts are those of the figures, which may be older than `PARTS`.
    """
    found = facts["microseconds"]
    names = dict.fromkeys(name for parts in found.values() for name in parts)
    rows = [[name, *(f"{parts[name]:.1f}" for parts in found.values())] for name in names]
    title = f"{facts['task']}, microseconds a control step (medians):"
    return f"{title}\n\n" + table(["part", *(f"N={size}" for size in found)], rows)


def profile(task: str, size: int, rounds: int, seconds: float) -> dict[str, float]:
    """Median over rounds of microseconds a control step, for each part."""
    env = arms.make(task, size)
    arm = arms.environment(env, task, task)
    spent = dict.fromkeys(PARTS, 0)
    samples: dict[str, list[float]] = {name: [] for name in (*PARTS, REST, WHOLE)}
    start = time.perf_counter()
    for step in range(20):
        arm.step(step)
    # Whole episodes, so that automatic resets are in it.
    count = 100 * max(1, round(seconds * 20 / (time.perf_counter() - start) / 100))
    for _ in range(rounds):
        whole = _per_step(arm.step, count)
        undo = [_time(env, path, spent, name) for name, path in PARTS.items()]
        timed = _per_step(arm.step, count)
        for restore in undo:
            restore()
        parts = {name: total / 1e3 / count for name, total in spent.items()}
        for name, value in parts.items():
            samples[name].append(value)
        samples[REST].append(timed - sum(parts.values()))
        samples[WHOLE].append(whole)
        spent.update(dict.fromkeys(PARTS, 0))
    arm.close()
    return {name: median(values) for name, values in samples.items()}


def _per_step(step: Callable[[int], object], count: int) -> float:
    start = time.perf_counter()
    for number in range(count):
        step(number)
    return 1e6 * (time.perf_counter() - start) / count


def _time(env: Any, path: tuple[str, ...], spent: dict[str, int], name: str) -> Callable[[], None]:
    """Replace a method of the instance by a timed one; returns what puts it back."""
    owner = env
    for attribute in path[:-1]:
        owner = getattr(owner, attribute)
    method = getattr(owner, path[-1])
    clock = time.perf_counter_ns

    def timed(*args: Any, **kwargs: Any) -> Any:
        start = clock()
        result = method(*args, **kwargs)
        spent[name] += clock() - start
        return result

    setattr(owner, path[-1], timed)
    return lambda: setattr(owner, path[-1], method)


if __name__ == "__main__":
    main()
