"""Control steps/s of every arm beside the bare batch: `python -m benchmarks.step_speed`.

One process for each number of environments: it builds all arms of that size and lets them take
turns in random order. The raw figures go to a JSON file. `log_cost` says better what a log costs.
With ``--device cuda`` tasks on MuJoCo Warp are measured instead (`warp_speed`).
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
from statistics import median
from typing import TYPE_CHECKING, Any

from benchmarks import arms, warp_speed
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
UNTIMED = "floor, no timers"
YAML, LINK, LOG = "random_reach", "random_reach + link pose", "random_reach + MCAP"
TUTORIAL, PUSH = "tutorial's class", "push_cube"
PUSH_FLOOR = "push_cube's floor, 2 threads"
TARGETS = {
    YAML: {1: 0.20, 8: 0.50, 64: 0.88, 1024: 0.93},
    LINK: {64: 0.85, 1024: 0.85},
    TUTORIAL: {1: 0.10, 8: 0.28, 64: 0.70, 1024: 0.88},
}


def main() -> None:
    """Measure, print the table, write the raw figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=0.1, help="about how long a turn is")
    parser.add_argument("--sizes", type=int, nargs="+", help=f"{SIZES}, of a device 4096")
    parser.add_argument("--log-sizes", type=int, nargs="*", default=list(LOG_SIZES))
    parser.add_argument("--episode", type=int, default=EPISODE, help="turns are multiples of it")
    parser.add_argument("--no-peers", action="store_true", help="leave out other packages' arms")
    parser.add_argument("--only", type=int, help="of the sizes, this one, in this process")
    parser.add_argument("--device", help="measure MuJoCo Warp there: cuda, cuda:N, cpu")
    parser.add_argument("--tasks", nargs="+", default=list(warp_speed.TASKS), help="on a device")
    parser.add_argument("--set", nargs="+", default=[], help="config on a device: a.b=value")
    parser.add_argument("--log", action="store_true", help="on a device: also with a log")
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    if options.device:
        facts, text = measured_on_device(options)
    else:
        facts, text = measured_on_cpu(options)
    print(text)
    if options.out:
        write_json(options.out, facts)


def measured_on_device(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Figures of MuJoCo Warp, and their table."""
    sizes = options.sizes or warp_speed.SIZES
    turns = options.rounds, options.seconds, options.episode
    found = warp_speed.measured(
        options.device, options.tasks, sizes, options.set, *turns, options.log
    )
    return {"rounds": options.rounds, **found}, warp_speed.report(found)


def measured_on_cpu(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Figures of MuJoCo on the CPU, and their table."""
    options.sizes = options.sizes or list(SIZES)
    sizes = sorted({*options.sizes, *options.log_sizes})
    here = options.only or (sizes[0] if len(sizes) == 1 else None)
    results = measured_here(here, options) if here else measured_apart(sizes)
    facts = {"rounds": options.rounds, "results": results}
    return facts, report(facts)


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
        if size in options.sizes:
            peers = size <= MAX_WORKERS and not options.no_peers
            built += further_arms(env, folder, peers)
        for arm in built:
            stack.callback(arm.close)
        results = measure(built, options.rounds, options.seconds, options.episode)
    return [result.facts() for result in results]


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
        arms.bare(UNTIMED, env, 2, FLOOR, timers=False),
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
    """A Markdown table: ratios to the floor."""
    fields = Result.__dataclass_fields__
    results = [Result(**{name: found[name] for name in fields}) for found in facts["results"]]
    sizes = sorted({result.num_envs for result in results})
    by = {(result.name, result.num_envs): result for result in results}
    rows = []
    for name in dict.fromkeys(result.name for result in results):
        cells = (_cell(by.get((name, size)), by.get((UNTIMED, size))) for size in sizes)
        rows.append([name, *cells])
    heading = (
        "Control steps/s, **ratio** to the 2-thread floor [lowest to highest] "
        "(to the one without timers), > its target:"
    )
    return heading + "\n\n" + table(["arm", *(f"N={size}" for size in sizes)], rows)


def _cell(result: Result | None, untimed: Result | None) -> str:
    if result is None:
        return ""
    speed = f"{result.speed / 1000:.1f}k"
    if result.name == result.floor:
        return speed
    low, high = min(result.ratios), max(result.ratios)
    target = TARGETS.get(result.name, {}).get(result.num_envs)
    aim = f" > {target:.2f}" if target else ""
    strict = ""
    if untimed is not None and result.floor == untimed.floor and result is not untimed:
        ratios = (a / b for a, b in zip(result.speeds, untimed.speeds, strict=True))
        strict = f" ({median(ratios):.2f})"
    return f"{speed} **{result.ratio:.2f}** [{low:.2f} to {high:.2f}]{strict}{aim}"


if __name__ == "__main__":
    main()
