"""`embodichain bench`: control steps/s of a task compared with the bare batch of the same model.

The bare arm is `mujoco.batch.Batch.step` with nothing bound: C threads over the same simulations,
with the same ctrl and without MuJoCo's timers. Both arms run alternately in one process, so that
their ratio does not depend on variations of the machine's speed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

import click

from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.cli.terminal.output import print_json, print_table
from embodichain.cli.verb import overrides, verb
from embodichain.cli.words import split_overrides
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["command"]

_ACTIONS = 16  # drawn before timing, to exclude the cost of a policy
_ROUND_SECONDS = 0.3


@dataclass(frozen=True)
class BenchOptions:
    """What was typed after `bench`.

    Attributes:
        words: Overrides; ``num_envs`` may list several numbers.
        rounds: How often each arm is measured.
        json: Print the result as one JSON object.
    """

    words: tuple[str, ...]
    rounds: int
    json: bool


@verb(
    "bench",
    ("bench task=random_reach num_envs=1,64,1024", "three sizes"),
    ("bench task=push_cube num_envs=64 --rounds 3 --json", "quicker, for scripts"),
    options=BenchOptions,
    keys=True,
    config_dir=True,
)
@overrides("task=NAME [num_envs=1,64,1024] [KEY=VALUE]...")
@click.option("--rounds", type=click.IntRange(1), default=7, help="Rounds of each arm. Default: 7.")
def command(options: BenchOptions) -> None:
    """Measure every requested number of environments."""
    from embodichain.config.resolved import resolve

    sizes, lines = _sizes(split_overrides(options.words))
    refuse_unread("bench", lines)
    configs = [resolve([*lines, *size, "record=none"], "run") for size in sizes]
    results = [_measure(config, options.rounds) for config in configs]
    task = configs[0].task_name
    if options.json:
        print_json({"task": task, "rounds": options.rounds, "results": results})
    else:
        print_table(f"{task}, control steps/s", results)


def _sizes(overrides: list[str]) -> tuple[list[list[str]], list[str]]:
    """Split ``num_envs=1,64`` into one override per size; returns these and the other overrides."""
    prefix = "num_envs="
    size_overrides = [override for override in overrides if override.startswith(prefix)]
    others = [override for override in overrides if not override.startswith(prefix)]
    if not size_overrides:
        return [[]], others
    last = size_overrides[-1]
    words = last.removeprefix(prefix).split(",")
    if not all(word.strip().isdecimal() and int(word) > 0 for word in words):
        message = f"must be one or more positive integers, got {last!r}"
        raise ConfigError([Problem("num_envs", message, "As in num_envs=1,64,1024")])
    return [[f"num_envs={int(word)}"] for word in words], others


def _measure(config: Resolved, rounds: int) -> dict[str, float]:
    """Build both arms and measure them alternately.

    Returns:
        ``num_envs``; speeds in control steps/s summed over environments, medians over rounds
        except ``slowest`` and ``fastest``; ``ratio``, the median of the two speeds' ratio.
    """
    from embodichain.config.environments.factory import make_env

    env = make_env(config)
    try:
        step_task, step_bare = _arms(env, config)
        steps = _steps_per_round(step_task)
        task_speeds = []
        bare_speeds = []
        for _ in range(rounds):
            task_speeds.append(_speed(step_task, steps))
            bare_speeds.append(_speed(step_bare, steps))
    finally:
        env.close()
    speeds = [env.num_envs * speed for speed in task_speeds]
    ratios = [task / bare for task, bare in zip(task_speeds, bare_speeds, strict=True)]
    return {
        "num_envs": env.num_envs,
        "steps_per_s": median(speeds),
        "slowest": min(speeds),
        "fastest": max(speeds),
        "bare_steps_per_s": env.num_envs * median(bare_speeds),
        "ratio": median(ratios),
    }


def _arms(env: BaseEnv, config: Resolved) -> tuple[Callable[[int], None], Callable[[int], None]]:
    """The environment with actions drawn beforehand, and the bare batch with the same ctrl."""
    from mujoco import batch as mjbatch

    from embodichain.cli.jobs.job import policy_of
    from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

    policy = policy_of(config.root, env)
    obs, _ = env.reset()
    engine = env.sim.engine
    if not isinstance(engine, CpuEngine):
        message = "bench compares with mujoco.batch on the CPU: sim.engine=mujoco"
        raise ConfigError([Problem("sim.engine", message)])
    actions = []
    controls = []
    for _ in range(_ACTIONS):
        actions.append(policy(obs, env))
        obs, *_ = env.step(actions[-1])
        controls.append(engine.state("ctrl").copy())
    batch = mjbatch.Batch(
        engine.model, env.num_envs, nthread=engine.num_threads, persistent=engine.persistent
    )
    batch.state[:] = engine.rows
    column = batch.state[:, engine.component("ctrl")]
    nstep = env.sim_steps_per_control

    def task(step: int) -> None:
        env.step(actions[step % _ACTIONS])

    def bare(step: int) -> None:
        column[:] = controls[step % _ACTIONS]
        batch.step(nstep=nstep)

    return task, bare


def _steps_per_round(arm: Callable[[int], None]) -> int:
    """Number of steps that take about a third of a second, after a warm-up."""
    _speed(arm, 4)
    return max(8, int(_speed(arm, 8) * _ROUND_SECONDS))


def _speed(arm: Callable[[int], None], steps: int) -> float:
    """Calls per second."""
    start = time.perf_counter()
    for step in range(steps):
        arm(step)
    return steps / (time.perf_counter() - start)
