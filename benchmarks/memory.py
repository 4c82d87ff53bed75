"""Memory per environment, and whether 16,384 fit in 2 GB: `python -m benchmarks.memory`.

Every size is a process of its own: what a process has freed, it seldom gives back.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.arms import LINK_POSE
from benchmarks.machine import table, write_json

SIZES = (1, 1024, 2048, 4096, 8192, 16384)
STEPS = 10
VARIANTS = {"random_reach": (), "random_reach + link pose": (LINK_POSE,)}
"""Looking at poses in every step makes the engine give each environment an MjData of its own."""

CHILD = """
import json, resource, sys
def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
def now():
    with open("/proc/self/statm") as file: pages = int(file.read().split()[1])
    return pages * resource.getpagesize()
import torch, tensordict, mujoco
from benchmarks import arms
imported = now()
env = arms.make("random_reach", int(sys.argv[1]), "seed=0", *sys.argv[3:])
arm = arms.environment(env, "memory", "memory")
for step in range(int(sys.argv[2])): arm.step(step)
print(json.dumps({"imported": imported, "running": now(), "peak": peak(),
                  "persistent": env.sim.engine.persistent}))
"""


def main() -> None:
    """Measure every size and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    options = parser.parse_args()
    facts = {
        "bytes": {
            name: {str(size): measure(size, overrides) for size in options.sizes}
            for name, overrides in VARIANTS.items()
        }
    }
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def report(facts: dict[str, Any]) -> str:
    """A Markdown table; the last column is what an environment adds to the first size's RSS."""
    rows = []
    for name, sizes in facts["bytes"].items():
        found = {int(size): one for size, one in sizes.items()}
        first = min(found)
        for size, one in found.items():
            mode = "each" if one["persistent"] else "a thread"
            grown = (one["running"] - found[first]["running"]) / 2**10 / max(1, size - first)
            mib = [f"{one[key] / 2**20:.0f}" for key in ("running", "peak")]
            rows.append([name, f"{size:,}", mode, *mib, f"{grown:.1f}" if size > first else ""])
    heads = ["task", "N", "an MjData", "RSS, MiB", "peak, MiB", "KiB an environment"]
    return f"After {STEPS} steps:\n\n" + table(heads, rows)


def measure(size: int, overrides: Sequence[str]) -> dict[str, int]:
    """RSS of a fresh process that has built N environments and stepped them."""
    command = [sys.executable, "-c", CHILD, str(size), str(STEPS), *overrides]
    child = subprocess.run(command, capture_output=True, text=True, check=False)
    if child.returncode:
        raise RuntimeError(child.stderr)
    facts: dict[str, int] = json.loads(child.stdout)
    return facts


if __name__ == "__main__":
    main()
