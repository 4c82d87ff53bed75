"""Control steps/s of every arm beside the bare batch: `python -m benchmarks.step_speed`.

One process for each number of environments: it builds all arms of that size and lets them take
turns in random order. The raw figures go to a JSON file.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks import arms
from benchmarks.arms import Arm
from benchmarks.machine import table, write_json
from benchmarks.peers import MAX_WORKERS, peer_arms
from benchmarks.plain_reach import write_scene
from benchmarks.rounds import EPISODE, Result, measure
from benchmarks.tutorial import make_tutorial

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

SIZES = (1, 8, 64, 1024)
LOG_SIZES = (4, 64, 1024)  # 4 is the everyday number of environments
FLOOR, FLOOR_1 = "floor, 2 threads", "floor, 1 thread"
YAML, LINK, LOG = "random_reach", "random_reach + link pose", "random_reach + MCAP"
TUTORIAL, PUSH = "tutorial's class", "push_cube"
PUSH_FLOOR = "push_cube's floor, 2 threads"
TARGETS = {
    YAML: {1: 0.20, 8: 0.50, 64: 0.88, 1024: 0.93},
    LINK: {64: 0.85, 1024: 0.85},
    TUTORIAL: {1: 0.10, 8: 0.28, 64: 0.70, 1024: 0.88},
}
LOG_LIMITS = {64: 0.15, 1024: 0.10}
SUBSTEPS = {1: 0.10, 10: 0.03}
"""Physics steps a control step, and the share that a log may cost at most with so many."""
SUBSTEPS_SIZE = 1024


def main() -> None:
    """Measure, print the table, write the raw figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=0.1, help="about how long a turn is")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--log-sizes", type=int, nargs="*", default=list(LOG_SIZES))
    parser.add_argument("--episode", type=int, default=EPISODE, help="turns are multiples of it")
    parser.add_argument("--no-peers", action="store_true", help="leave out other packages' arms")
    parser.add_argument("--only", type=int, help="of the sizes, this one, in this process")
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    sizes = sorted({*options.sizes, *options.log_sizes})
    here = options.only or (sizes[0] if len(sizes) == 1 else None)
    results = measured_here(here, options) if here else measured_apart(sizes)
    facts = {"rounds": options.rounds, "results": results}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def measured_apart(sizes: Sequence[int]) -> list[dict[str, Any]]:
    """Results of every size, each measured in a process of its own: its arms alone fill memory."""
    found: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="step_speed-") as folder:
        out = Path(folder) / "size.json"
        for size in sizes:
            command = [sys.executable, "-m", "benchmarks.step_speed", *sys.argv[1:]]
            command += ["--only", str(size), "--out", str(out)]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            found += json.loads(out.read_text())["results"]
            print(f"N={size} measured", flush=True)
    return found


def measured_here(size: int, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Results of one size."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="step_speed-")))
        env = arms.make("random_reach", size)
        built = [arms.environment(env, YAML, FLOOR), arms.bare(FLOOR, env, 2)]
        if size in options.log_sizes:
            logged = arms.make("random_reach", size)
            built.append(arms.recorded(logged, LOG, FLOOR, folder))
            if size == SUBSTEPS_SIZE:
                built += substeps_arms(size, folder)
        if size in options.sizes:
            peers = size <= MAX_WORKERS and not options.no_peers
            built += further_arms(env, folder, peers)
        for arm in built:
            stack.callback(arm.close)
        results = measure(built, options.rounds, options.seconds, options.episode)
    return [result.facts() for result in results]


def substeps_arms(size: int, folder: Path) -> list[Arm]:
    """random_reach with other numbers of physics steps a control step, without and with a log."""
    built = []
    for count in SUBSTEPS:
        name, logged_name, floor = substeps_names(count)
        override = f"task.sim_steps_per_control={count}"
        env, logged = (arms.make("random_reach", size, override) for _ in range(2))
        built += [arms.environment(env, name, floor), arms.bare(floor, env, 2)]
        built.append(arms.recorded(logged, logged_name, floor, folder))
    return built


def substeps_names(count: int) -> tuple[str, str, str]:
    """Names of the arms without a log, with one, and of the floor."""
    steps = f"{count} physics step" + ("s" if count > 1 else "")
    return f"{YAML}, {steps}", f"{LOG}, {steps}", f"{FLOOR}, {steps}"


def further_arms(env: BaseEnv, folder: Path, peers: bool) -> list[Arm]:
    """What is compared with random_reach and its floor, at the same size.

    Args:
        env: random_reach.
        folder: Where peers find the scene.
        peers: Whether to build other packages' vector environments.
    """
    size = env.num_envs
    linked = arms.make("random_reach", size, arms.LINK_POSE)
    push = arms.make("push_cube", size)
    built = [
        arms.bare(FLOOR_1, env, 1, FLOOR),
        arms.environment(linked, LINK, FLOOR),
        arms.environment(make_tutorial(size), TUTORIAL, FLOOR),
        arms.environment(push, PUSH, PUSH_FLOOR),
        arms.bare(PUSH_FLOOR, push, 2),
    ]
    if peers:
        nstep = env.sim_steps_per_control
        write_scene(folder, env.sim.engine.model, env.sim.engine.rows[0])
        built += peer_arms(folder, nstep, arms.actions_for(env), FLOOR)
    return built


def report(facts: dict[str, Any]) -> str:
    """Two Markdown tables: ratios to the floor, and the log's cost."""
    fields = Result.__dataclass_fields__
    results = [Result(**{name: found[name] for name in fields}) for found in facts["results"]]
    sizes = sorted({result.num_envs for result in results})
    by = {(result.name, result.num_envs): result for result in results}
    rows = []
    for name in dict.fromkeys(result.name for result in results):
        rows.append([name, *(_cell(by.get((name, size))) for size in sizes)])
    parts = [
        "Control steps/s, **ratio** to the 2-thread floor [lowest to highest], > its target:",
        table(["arm", *(f"N={size}" for size in sizes)], rows),
        "What the log costs, as a share of a step without it:",
        table(["N", "physics steps", "cost", "at most"], _costs(by)),
    ]
    return "\n\n".join(parts)


def _cell(result: Result | None) -> str:
    if result is None:
        return ""
    speed = f"{result.speed / 1000:.1f}k"
    if result.name == result.floor:
        return speed
    low, high = min(result.ratios), max(result.ratios)
    target = TARGETS.get(result.name, {}).get(result.num_envs)
    aim = f" > {target:.2f}" if target else ""
    return f"{speed} **{result.ratio:.2f}** [{low:.2f} to {high:.2f}]{aim}"


def _costs(by: dict[tuple[str, int], Result]) -> list[list[str]]:
    """Rows of the table of what the log costs."""
    asked = [(YAML, LOG, "4", n, LOG_LIMITS.get(n)) for name, n in by if name == LOG]
    for count, limit in SUBSTEPS.items():
        name, logged, _ = substeps_names(count)
        asked += [(name, logged, str(count), n, limit) for other, n in by if other == logged]
    rows = []
    for name, logged, steps, size, limit in asked:
        costs = _shares(by[name, size], by[logged, size])
        cost = costs[len(costs) // 2]
        cell = f"{cost:.1%} [{costs[0]:.1%} to {costs[-1]:.1%}]"
        verdict = "" if limit is None else f"{limit:.0%}, {'met' if cost <= limit else 'missed'}"
        rows.append([str(size), steps, cell, verdict])
    return rows


def _shares(plain: Result, logged: Result) -> list[float]:
    """Time with the log over time without it, less one, of every round; sorted."""
    pairs = zip(plain.speeds, logged.speeds, strict=True)
    return sorted(without / with_log - 1 for without, with_log in pairs)


if __name__ == "__main__":
    main()
