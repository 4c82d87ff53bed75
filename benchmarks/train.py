"""What learning costs on `reach`: `python -m benchmarks.train`.

PPO at equal settings: on our environment through `SB3VecEnv`, as `embodichain train` runs it, on
`DummyVecEnv` around a plain `gymnasium.Env` (`plain_task.py`), and as one file without
Stable-Baselines3 (`ppo_loop.py`). One process, one thread of torch, turns in random order.
"""

from __future__ import annotations

import argparse
import gc
import json
import random
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.learners import (
    DUMMY,
    LOOP,
    OURS,
    PARTS,
    TRAIN,
    Learner,
    Settings,
    build,
    time_to_success,
)
from benchmarks.machine import table, write_json

SPEED, SOLVE = "speed", "solve"
SETTINGS = {SPEED: (256, Settings(32, 2048, 4)), SOLVE: (64, Settings(64, 1024, 10))}
SUCCESS = 0.95
WANTED = {SPEED: 1.5, SOLVE: 1.3}
"""Times `DummyVecEnv`'s speed, and its time to `SUCCESS` over ours, at least."""
BEHIND = 0.90
"""Share of the loop's speed, at least."""


def main() -> None:
    """Measure, print the tables, write the raw figures; parts left out stay as they were."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=(SPEED, SOLVE), default=[SPEED, SOLVE])
    parser.add_argument("--rounds", type=int, default=5, help="turns of each")
    parser.add_argument("--seeds", type=int, default=15, help="trainings of each")
    parser.add_argument("--rollouts", type=int, default=25, help="rollouts and updates of a turn")
    parser.add_argument("--limit", type=int, default=1_000_000, help="steps to solve it in")
    parser.add_argument("--envs", type=int, help="other numbers of environments, to try it out")
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    facts: dict[str, Any] = {}
    if options.out and options.out.is_file():
        facts = {k: v for k, v in json.loads(options.out.read_text()).items() if k != "machine"}
    for part in options.parts:
        count, settings = SETTINGS[part]
        count = options.envs or count
        if part == SPEED:
            facts[part] = speed(count, settings, options.rounds, options.rollouts)
        else:
            facts[part] = solve(count, settings, options.seeds, options.limit)
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def speed(count: int, settings: Settings, rounds: int, rollouts: int) -> dict[str, Any]:
    """Environment steps/s of every learner, and milliseconds a rollout by part."""
    order = random.Random(0)
    steps = count * settings.n_steps * rollouts
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="train-")))
        learners = [build(name, count, settings, 0, folder) for name in (OURS, TRAIN, DUMMY, LOOP)]
        for learner in learners:
            stack.callback(learner.close)
            learner.learn(1)  # builds what is built late
            learner.spent.clear()
        gc.collect()
        gc.freeze()  # as the command line does once everything is built
        speeds: dict[str, list[float]] = {learner.name: [] for learner in learners}
        for number in range(rounds):
            for learner in order.sample(learners, len(learners)):
                begun = time.perf_counter()
                learner.learn(rollouts)
                speeds[learner.name].append(steps / (time.perf_counter() - begun))
            print(f"round {number + 1} of {rounds}", flush=True)
        parts = {learner.name: _parts(learner, rounds * rollouts) for learner in learners}
    return {"num_envs": count, **settings.shape(), "steps_per_second": speeds, "ms": parts}


def _parts(learner: Learner, rollouts: int) -> dict[str, float]:
    """Milliseconds that a rollout and its update spend in each part."""
    return {name: 1e3 * seconds / rollouts for name, seconds in learner.spent.items()}


def solve(count: int, settings: Settings, seeds: int, limit: int) -> dict[str, Any]:
    """Seconds and environment steps to `SUCCESS` over the last 200 episodes, by seed."""
    order = random.Random(0)
    found: dict[str, list[dict[str, Any]]] = {OURS: [], DUMMY: []}
    for seed in range(seeds):
        for name in order.sample(list(found), len(found)):
            entry = time_to_success(name, count, settings, seed, SUCCESS, limit)
            found[name].append(entry)
            print(f"seed {seed}: {name} {entry}", flush=True)
    return {"num_envs": count, **settings.shape(), "limit": limit, "found": found}


def report(facts: dict[str, Any]) -> str:
    """Markdown tables: speed, where a rollout goes, time to success."""
    parts = []
    if SPEED in facts:
        parts += _speed_tables(facts[SPEED])
    if SOLVE in facts:
        parts += _solve_table(facts[SOLVE])
    return "\n\n".join(parts)


def _title(facts: dict[str, Any]) -> str:
    return (
        "{num_envs} environments x {n_steps} steps, batch {batch_size}, {n_epochs} epochs".format(
            **facts
        )
    )


def _speed_tables(facts: dict[str, Any]) -> list[str]:
    speeds, ms = facts["steps_per_second"], facts["ms"]
    rows = []
    for name, own in speeds.items():
        to_dummy = _ratio(own, speeds[DUMMY]) if name != DUMMY else ""
        to_loop = _ratio(own, speeds[LOOP]) if name not in (DUMMY, LOOP) else ""
        if name == OURS:
            to_dummy, to_loop = f"{to_dummy} > {WANTED[SPEED]}", f"{to_loop} > {BEHIND:.2f}"
        rows.append([name, f"{median(own) / 1000:.1f}k", to_dummy, to_loop])
    split = [[part, *(_cell(ms[name], part) for name in ms)] for part in PARTS]
    return [
        f"{_title(facts)}, > the target:",
        table(["PPO", "env-steps/s", f"to {DUMMY}", f"to {LOOP}"], rows),
        "Milliseconds of a rollout and its update:",
        table(["", *ms], split),
    ]


def _cell(ms: dict[str, float], part: str) -> str:
    if part not in ms:
        return "below"
    return f"{ms[part]:.0f}"


def _ratio(own: list[float], other: list[float]) -> str:
    """Median of the turns' ratios, and the spread."""
    ratios = sorted(a / b for a, b in zip(own, other, strict=True))
    return f"**{median(ratios):.2f}** [{ratios[0]:.2f} to {ratios[-1]:.2f}]"


def _solve_table(facts: dict[str, Any]) -> list[str]:
    found = facts["found"]
    rows = []
    for name, entries in found.items():
        seconds = [entry["seconds"] for entry in entries]
        solved = [value for value in seconds if value is not None]
        steps = [entry["env_steps"] for entry in entries]
        if len(solved) < len(seconds):
            cells = [f"not in {facts['limit']:,} steps", "", ""]
        else:
            ratio = ""
            if name == OURS and all(entry["seconds"] is not None for entry in found[DUMMY]):
                other = [entry["seconds"] for entry in found[DUMMY]]
                ratio = f"{_ratio(other, solved)} > {WANTED[SOLVE]}"
            spread = f"{median(solved):.1f} [{min(solved):.1f} to {max(solved):.1f}]"
            cells = [spread, f"{median(steps) / 1000:.0f}k", ratio]
        rows.append([name, *cells])
    heads = ["PPO", f"s to {SUCCESS:.0%}", "env-steps", "faster"]
    return [f"{_title(facts)}, {len(next(iter(found.values())))} seeds:", table(heads, rows)]


if __name__ == "__main__":
    main()
