"""What an update for viewers costs: `python -m benchmarks.view_cost`.

An update is everything of one moment and one viewed environment: poses, joints, numbers, and its
share of scenes and lines. Counted is the CPU time of the process beside a log without viewers. The
difference is a few per cent of a step: the median has to be over many turns.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from itertools import count, islice
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.machine import table, write_json
from benchmarks.medians import sure

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv

TASKS = ("random_reach", "push_cube", "lift_cube", "quadruped_velocity")
NUM_ENVS, STEPS, ROUNDS = 4, 300, 21
LIMIT_MS = 0.1
BEFORE = 2
"""Steps before the clock starts: what is made once does not count, meshes and attachments."""
EVERY_STEP = 1e9
VIEW_HZ = 10.0
"""The default of `record.view_hz`."""


def main() -> None:
    """Measure every task in a process of its own, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS))
    parser.add_argument("--num-envs", type=int, default=NUM_ENVS)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    sizes = options.num_envs, options.steps, options.rounds
    if options.child:
        print(json.dumps(measure(options.tasks[0], *sizes)))
        return
    facts = {"num_envs": options.num_envs, "tasks": {t: _apart(t, *sizes) for t in options.tasks}}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def measure(task: str, num_envs: int, steps: int, rounds: int) -> dict[str, Any]:
    """Return ms of CPU an update of one environment in each pair of turns, and ms a step."""
    from benchmarks import arms
    from embodichain.recording import McapRecorder
    from embodichain.recording.format.options import RecordOptions

    env = arms.make(task, num_envs)
    actions, number = _actions(env, steps + BEFORE), count()

    def turn(folder: Path, view_envs: list[int]) -> tuple[float, float]:
        env.reset(seed=0)  # the same states in every turn: contacts cost more than viewers
        options = RecordOptions(view_envs=view_envs, view_hz=EVERY_STEP)
        recorder = McapRecorder(folder / f"{next(number)}.mcap", env, options=options)
        env.add_observer(recorder)
        for action in islice(actions, BEFORE):
            env.step(action)
        recorder.flush()
        begun = time.process_time(), time.perf_counter()
        for action in islice(actions, BEFORE, None):
            env.step(action)
        recorder.flush()
        cpu, wall = time.process_time() - begun[0], time.perf_counter() - begun[1]
        env.remove_observer(recorder)
        recorder.close()
        return cpu, wall

    with tempfile.TemporaryDirectory() as folder:
        viewed, pairs = list(range(num_envs)), list[list[tuple[float, float]]]()
        for pair in range(rounds + 1):
            order = [viewed, []] if pair % 2 else [[], viewed]  # the machine's speed wanders
            both = [turn(Path(folder), view_envs) for view_envs in order]
            pairs.append(both if pair % 2 else both[::-1])
    env.close()
    each = 1e3 / (steps * num_envs)
    return {
        "costs": sorted(each * (seen[0] - unseen[0]) for seen, unseen in pairs[1:]),
        "step": 1e3 / steps * median(unseen[1] for _, unseen in pairs[1:]),
        "dt": float(env.step_dt),
    }


def _actions(env: BaseEnv, steps: int) -> list[torch.Tensor]:
    """Half of what is allowed, at random."""
    import torch

    low, high = (np.clip(x, -1, 1) for x in (env.action_space.low, env.action_space.high))
    draw = np.random.default_rng(0).uniform(low / 2, high / 2, (steps, *low.shape))
    return list(torch.from_numpy(draw.astype(np.float32)))


def report(facts: dict[str, Any]) -> str:
    """A Markdown table: an update, and the share of a step at the default rate and at any.

    In brackets where the median lies with 90 %.
    """
    rows = []
    for task, one in facts["tasks"].items():
        cost, (low, high) = median(one["costs"]), sure(one["costs"])
        rate = min(1.0, VIEW_HZ * one["dt"])
        shares = [100 * facts["num_envs"] * cost * r / one["step"] for r in (rate, 1.0)]
        verdict = "yes" if cost <= LIMIT_MS else "no"
        cells = [f"**{cost:.3f}** [{low:.3f} to {high:.3f}]", verdict]
        rows.append([task, *cells, f"{one['step']:.2f}", *(f"{s:.0f} %" for s in shares)])
    heads = ["task", "an update, ms", f"at most {LIMIT_MS}"]
    heads += ["a step, ms", f"share at {VIEW_HZ:.0f} Hz", "share at every step"]
    title = f"An update of one viewed environment ({facts['num_envs']} of {facts['num_envs']}):\n\n"
    return title + table(heads, rows)


def _apart(task: str, num_envs: int, steps: int, rounds: int) -> dict[str, Any]:
    sizes = ["--num-envs", str(num_envs), "--steps", str(steps), "--rounds", str(rounds)]
    command = [sys.executable, "-m", "benchmarks.view_cost", "--child", "--tasks", task, *sizes]
    child = subprocess.run(command, capture_output=True, text=True, check=False)
    if child.returncode:
        raise RuntimeError(child.stderr)
    found: dict[str, Any] = json.loads(child.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    main()
