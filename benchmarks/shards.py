"""What shards cost: `python -m benchmarks.shards`.

A Ray cluster of nodes with a core each, on this machine: one shard on one core against two shards
on two cores, each with as many environments, in rounds that take turns. Two efficiencies: by wall
time, the speed of two over twice the speed of one; it needs a machine with nothing else to do. By
CPU time, that of one shard over that of everything with two (shards, driver, Ray), both for an
environment step; other programs do not change it, and waiting is not in it.

`inside`: the policy acts in the shards, as in `run policy=random`; `step`: actions are sent and
observations fetched in every control step, as in a training. Actors are pinned to a core each; Ray
and the driver share both cores with them.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import torch

import embodichain
from benchmarks.machine import table, write_json
from embodichain.learning.episode_statistics import EpisodeStatistics
from embodichain.learning.evaluation.sharded_play import play_sharded

WAYS = ("inside", "step")
TARGET = 0.85


def main() -> None:
    """Measure, print the table, write the raw figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="reach")
    parser.add_argument("--envs", type=int, nargs="+", default=[256, 1024], help="of each shard")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=2.0, help="of a turn")
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    torch.set_num_threads(1)
    facts: dict[str, Any] = {"task": options.task, "rounds": options.rounds, "target": TARGET}
    with cluster(2) as address:
        how = options.task, options.rounds, options.seconds, address
        facts["sizes"] = {str(count): measure(count, *how) for count in options.envs}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


@contextmanager
def cluster(nodes: int) -> Iterator[str]:
    """A cluster of nodes with a core each; Ray's own niceness of workers is off."""
    os.environ |= {"RAY_worker_niceness": "0", "RAY_AUTH_MODE": "disabled"}
    os.environ |= {"RAY_memory_monitor_refresh_ms": "0"}
    os.environ |= {"RAY_max_direct_call_object_size": "8000000"}  # as docs/scale.md advises
    import ray
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 0, "object_store_memory": 100_000_000, "include_dashboard": False}
    made = Cluster(initialize_head=True, head_node_args=head)
    try:
        for _ in range(nodes + 1):  # one more for the shard alone
            made.add_node(num_cpus=1, object_store_memory=100_000_000)
        ray.init(address=made.address, log_to_driver=False)
        yield made.address
    finally:
        ray.shutdown()
        made.shutdown()


@dataclass
class Turn:
    """One turn of a batch.

    Attributes:
        steps: Environment steps.
        seconds: Wall time.
        shards: CPU seconds of the shards' processes.
        all: CPU seconds of these, the driver and every process of Ray.
    """

    steps: int
    seconds: float
    shards: float
    all: float


def measure(count: int, task: str, rounds: int, seconds: float, address: str) -> dict[str, Any]:
    """The turns of one and of two shards, one a round, and the efficiencies."""
    arms = {shards: batch(task, shards, count, address) for shards in (1, 2)}
    found: dict[str, dict[str, list[Turn]]] = {way: {"1": [], "2": []} for way in WAYS}
    try:
        for number in range(rounds + 1):
            for way in WAYS:
                for shards, env in arms.items():
                    turn = taken(env, globals()[f"advance_{way}"], seconds)
                    if number:  # the first round is dropped
                        found[way][str(shards)].append(turn)
    finally:
        for env in arms.values():
            env.close()
    return {
        way: {
            **{name: [asdict(turn) for turn in mine] for name, mine in turns.items()},
            "efficiency_wall": median(
                speed(b) / (2 * speed(a)) for a, b in zip(turns["1"], turns["2"], strict=True)
            ),
            "efficiency_cpu": median(
                (a.shards / a.steps) / (b.all / b.steps)
                for a, b in zip(turns["1"], turns["2"], strict=True)
            ),
        }
        for way, turns in found.items()
    }


def speed(turn: Turn) -> float:
    """Environment steps a second of wall time."""
    return turn.steps / turn.seconds


def taken(env: Any, advance: Callable[[Any, float], int], seconds: float) -> Turn:
    """Advance a batch for some seconds."""
    pids = env.advance(pid, [()] * len(env.pool.counts))
    cpu, everything, start = cpu_of(pids), cpu_of(descendants()), time.perf_counter()
    steps = advance(env, seconds) * env.num_envs
    wall = time.perf_counter() - start
    return Turn(steps, wall, cpu_of(pids) - cpu, cpu_of(descendants()) - everything)


def pid(env: Any) -> int:
    """The process of a shard."""
    return os.getpid()


def descendants() -> list[int]:
    """This process and all that it started: the driver, Ray's processes, the shards."""
    parents = {}
    for name in filter(str.isdigit, os.listdir("/proc")):
        with suppress(OSError):
            stat = Path(f"/proc/{name}/stat").read_text()
            parents[int(name)] = int(stat.rpartition(")")[2].split()[1])
    found = {os.getpid()}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return sorted(found)


def cpu_of(pids: list[int]) -> float:
    """CPU seconds that processes have used so far."""
    ticks = 0
    for one in pids:
        with suppress(OSError):
            fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def batch(task: str, shards: int, count: int, address: str) -> Any:
    """A batch whose shards are pinned to a core each."""
    lines = ["sim.backend=ray", f"sim.shards={shards}", f"sim.ray.address={address}"]
    env: Any = embodichain.make(task, shards * count, lines, seed=1)
    cores = sorted(os.sched_getaffinity(0))
    env.advance(pin, [(cores[k % len(cores)],) for k in range(shards)])
    env.reset()
    return env


def pin(env: Any, core: int) -> None:
    """Pin every thread of this process to a core."""
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), {core})


def advance_inside(env: Any, seconds: float) -> int:
    """Random actions drawn in the shards; returns the control steps."""
    counted = EpisodeStatistics(env.num_envs, 10**9)
    start = time.perf_counter()
    for _ in play_sharded(env, "random", counted):
        if time.perf_counter() - start > seconds:
            break
    return counted.steps


def advance_step(env: Any, seconds: float) -> int:
    """Actions and observations through this process; returns the control steps."""
    action = torch.zeros(env.num_envs, env.single_action_space.shape[0])
    start, steps = time.perf_counter(), 0
    while time.perf_counter() - start < seconds:
        env.step(action)
        steps += 1
    return steps


def report(facts: dict[str, Any]) -> str:
    """The table."""
    rows = []
    for count, ways in facts["sizes"].items():
        for way in WAYS:
            found = ways[way]
            one = median(turn["steps"] / turn["shards"] for turn in found["1"])
            two = median(turn["steps"] / turn["all"] for turn in found["2"])
            efficiencies = found["efficiency_cpu"], found["efficiency_wall"]
            rows.append(
                (
                    f"{way}, {count} environments a shard",
                    *(f"{one:,.0f}", f"{two:,.0f}"),
                    *(f"{value:.2f}" for value in efficiencies),
                )
            )
    heads = (f"`{facts['task']}`, steps", "a CPU s of one shard", "a CPU s of all, two shards")
    return table([*heads, "of linear, CPU time", "wall time"], rows)


if __name__ == "__main__":
    main()
