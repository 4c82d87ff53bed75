"""Memory per environment, and whether 16,384 fit in 2 GB: `python -m benchmarks.memory`.

Every size is a process of its own: what a process has freed, it seldom gives back.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.machine import table, write_json

SIZES = (1, 256, 1024, 2048, 4096, 8192, 16384)
STEPS = 3

CHILD = """
import json, resource, sys
def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
def now():
    with open("/proc/self/statm") as file: pages = int(file.read().split()[1])
    return pages * resource.getpagesize()
import torch, tensordict, mujoco
from benchmarks import arms
imported = now()
env = arms.make(sys.argv[1], int(sys.argv[2]), "seed=0")
arm = arms.environment(env, "memory", "memory")
for step in range(int(sys.argv[3])): arm.step(step)
print(json.dumps({"imported": imported, "running": now(), "peak": peak(),
                  "persistent": env.sim.engine.persistent}))
"""


def main() -> None:
    """Measure every size and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="random_reach")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    options = parser.parse_args()
    found = {size: measure(options.task, size) for size in options.sizes}
    facts = {"task": options.task, "bytes": {str(size): one for size, one in found.items()}}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def report(facts: dict[str, Any]) -> str:
    """A Markdown table; the last column is what an environment adds to the first size's RSS."""
    found = {int(size): one for size, one in facts["bytes"].items()}
    first = min(found)
    rows = []
    for size, one in found.items():
        mode = "an MjData each" if one["persistent"] else "an MjData a thread"
        grown = (one["running"] - found[first]["running"]) / 2**10 / max(1, size - first)
        mib = [f"{one[key] / 2**20:.0f}" for key in ("running", "peak")]
        rows.append([f"{size:,}", mode, *mib, f"{grown:.1f}" if size > first else ""])
    heads = ["N", "simulations", "RSS, MiB", "peak, MiB", "KiB an environment"]
    return f"{facts['task']}, after {STEPS} steps:\n\n" + table(heads, rows)


def measure(task: str, size: int) -> dict[str, int]:
    """RSS of a fresh process that has built N environments and stepped them."""
    command = [sys.executable, "-c", CHILD, task, str(size), str(STEPS)]
    child = subprocess.run(command, capture_output=True, text=True, check=False)
    if child.returncode:
        raise RuntimeError(child.stderr)
    facts: dict[str, int] = json.loads(child.stdout)
    return facts


if __name__ == "__main__":
    main()
