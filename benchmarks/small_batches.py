"""What a few environments cost beside a plain one: `python -m benchmarks.small_batches`.

CPU time of this thread, so that other programs matter little; ratios within one process. Three
tables: `reach` through `SB3VecEnv` over Stable-Baselines3's `DummyVecEnv` of `plain_task`; what a
step costs beyond physics at N=1, in steps of the plain environment; the step at N=1,024 over the
floor, physics alone with MuJoCo's timers stopped.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

from benchmarks import arms
from benchmarks.machine import table, write_json
from benchmarks.plain_task import PlainTask
from embodichain.learning import SB3VecEnv

SIZES = (1, 4, 8, 64)
LARGE = 1024
THREAD = "sim.num_threads=1"
TASKS = ("reach", "quadruped_velocity", "pick_place")
SB3_TARGETS = {1: 0.55, 4: 1.0, 8: 1.25, 64: 1.9}
TASK_TARGETS = {"reach": 1.7, "quadruped_velocity": 5.9}
"""Half of what they took before a step was computed in arrays."""
FLOOR_TARGET = 0.93


def main() -> None:
    """Measure, print the tables, write the raw figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--steps", type=int, default=2000, help="environment steps of a turn")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--large", type=int, default=LARGE)
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rounds, steps = options.rounds, options.steps
    facts: dict[str, Any] = {
        "rounds": rounds,
        "sb3": {size: vectorized(size, rounds, steps) for size in options.sizes},
        "beyond_physics": beyond_physics(rounds, steps),
        "large": over_floor(options.large, rounds, max(4, steps // options.large)),
        "num_envs_large": options.large,
    }
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def turns(
    calls: dict[str, Callable[[], object]], rounds: int, count: int
) -> dict[str, list[float]]:
    """CPU microseconds a call, one figure a round; arms take turns, the first round is dropped."""
    found: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(rounds + 1):
        for name, call in calls.items():
            start = time.thread_time()
            for _ in range(count):
                call()
            if number:
                found[name].append(1e6 * (time.thread_time() - start) / count)
    return found


def plain_task(env: Any) -> PlainTask:
    """The plain environment over the compiled scene of `reach`."""
    return PlainTask(env.sim.engine.model, env.sim.initial_row, env.sim_steps_per_control)


def vectorized(size: int, rounds: int, steps: int) -> dict[str, list[float]]:
    """A step of `reach` through SB3VecEnv, and of DummyVecEnv over plain environments."""
    env = arms.make("reach", size, THREAD)
    ours, dummy = SB3VecEnv(env), DummyVecEnv([lambda: plain_task(env)] * size)
    ours.reset(), dummy.reset()
    actions = arms.actions_for(env)
    numbers = iter(range(10**9))

    def stepped(venv: Any) -> Callable[[], object]:
        return lambda: venv.step(actions[next(numbers) % len(actions)])

    found = turns({"ours": stepped(ours), "dummy": stepped(dummy)}, rounds, max(4, steps // size))
    ours.close()
    return found


def beyond_physics(rounds: int, steps: int) -> dict[str, dict[str, list[float]]]:
    """A step at N=1 of each task, its physics alone, and a step of the plain environment."""
    found: dict[str, dict[str, list[float]]] = {}
    for task in TASKS:
        env, bare, reach = (arms.make(name, 1, THREAD) for name in (task, task, "reach"))
        action = torch.zeros(env.action_space.shape)
        env.reset(), bare.reset()
        plain = plain_task(reach)
        plain.reset(seed=0)
        still = np.zeros(plain.action_space.shape, np.float32)

        def alone(plain: PlainTask = plain, still: Any = still) -> None:
            if plain.step(still)[3]:
                plain.reset()

        calls: dict[str, Callable[[], object]] = {
            "step": lambda env=env, action=action: env.step(action),
            "physics": lambda bare=bare: bare.sim.engine.step(bare.sim_steps_per_control),
            "plain": alone,
        }
        found[task] = turns(calls, rounds, steps)
        for one in (env, bare, reach):
            one.close()
    return found


def over_floor(size: int, rounds: int, count: int) -> dict[str, list[float]]:
    """A step of `reach`, and its physics alone."""
    env, bare = (arms.make("reach", size, THREAD) for _ in range(2))
    env.reset(), bare.reset()
    action = torch.zeros(env.action_space.shape)
    calls: dict[str, Callable[[], object]] = {
        "step": lambda: env.step(action),
        "physics": lambda: bare.sim.engine.step(bare.sim_steps_per_control),
    }
    found = turns(calls, rounds, count)
    env.close(), bare.close()
    return found


def report(facts: dict[str, Any]) -> str:
    """Three Markdown tables."""
    rows = []
    for size, found in facts["sb3"].items():
        ratio = _ratio(found["dummy"], found["ours"])
        aim = SB3_TARGETS.get(int(size))
        us = f"{median(found['ours']):.0f}", f"{median(found['dummy']):.0f}"
        rows.append([f"{size}", *us, _judged(ratio, aim, ratio >= (aim or 0.0))])
    heading = ["N", "SB3VecEnv, us", "DummyVecEnv, us", "speed over DummyVecEnv"]
    parts = ["reach through SB3VecEnv, CPU time a step:", "", table(heading, rows)]
    rows = []
    for task, found in facts["beyond_physics"].items():
        extra = [a - b for a, b in zip(found["step"], found["physics"], strict=True)]
        us = (f"{median(found[name]):.0f}" for name in ("step", "physics", "plain"))
        ratio = _ratio(extra, found["plain"])
        aim = TASK_TARGETS.get(task)
        rows.append([task, *us, _judged(ratio, aim, aim is not None and ratio <= aim)])
    heading = ["N=1", "step, us", "physics, us", "plain step, us", "beyond physics, plain steps"]
    parts += ["", table(heading, rows), ""]
    large, count = facts["large"], facts["num_envs_large"]
    share = _ratio(large["physics"], large["step"])
    judged = _judged(share, FLOOR_TARGET, share >= FLOOR_TARGET)
    parts.append(f"reach at N={count} over the floor: {judged}")
    return "\n".join(parts)


def _judged(value: float, target: float | None, met: bool) -> str:
    """A figure beside its target."""
    beside = "" if target is None else f", target {target}: {'met' if met else 'missed'}"
    return f"**{value:.2f}**{beside}"


def _ratio(above: list[float], below: list[float]) -> float:
    return median(a / b for a, b in zip(above, below, strict=True))


if __name__ == "__main__":
    main()
