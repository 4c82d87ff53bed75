"""Whether tasks of each kind are learned at once: `python -m benchmarks.task_kinds`.

For each kind and robot `embodichain new task NAME --kind KIND --robot FILE`, then for `pick` its
expert in 256 episodes, for the others `embodichain train task=NAME seed=S`, all without an edit.
CPU seconds are those of the whole command; on two idle cores it takes about half of them.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.machine import table, write_json
from embodichain.learning.evaluation.statistics import rate
from tests.helpers.invented_robots import GRIPPER_ARM, MOTOR_DOG, PLIERS

FILES = {"gripper_arm.xml": GRIPPER_ARM, "pliers.xml": PLIERS, "dog.xml": MOTOR_DOG}
"""Robots written for this measurement, which nothing in the package has seen."""
ROBOTS = {
    "reach": ["gripper_arm.xml", "panda_description/urdf/panda.urdf"],
    "push": ["gripper_arm.xml", "panda_description/urdf/panda.urdf"],
    "pick": ["gripper_arm.xml", "pliers.xml", "panda_description/urdf/panda.urdf"],
    "velocity": ["dog.xml", "go1_description/urdf/go1.urdf"],
}
"""Kind -> robots, as `--robot` takes them."""
_EXPERT_EPISODES = 256


def main() -> None:
    """Measure each kind with each robot, one after the other, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    facts: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, text in FILES.items():
            Path(folder, name).write_text(text)
        for kind in options.kinds:
            for number, robot in enumerate(ROBOTS[kind]):
                task = f"{kind}{number}"
                run(folder, "new", "task", task, "--kind", kind, "--robot", robot)
                for seed in options.seeds:
                    facts.append({"kind": kind, "robot": robot} | measure(folder, kind, task, seed))
                    print(facts[-1], file=sys.stderr, flush=True)
    print(report(facts))
    if options.out:
        write_json(options.out, {"rows": facts})


def measure(folder: str, kind: str, task: str, seed: int) -> dict[str, Any]:
    """Return steps, CPU seconds, and the share of successes with its interval."""
    out = Path(folder, f"{task}_{seed}")
    words = [f"task={task}", f"seed={seed}", f"hydra.run.dir={out}", "record=none"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    if kind == "pick":
        episodes = _EXPERT_EPISODES // 64
        run(folder, "run", *words, "policy=expert", "num_envs=64", f"episodes={episodes}")
    else:
        run(folder, "train", *words)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    summary = json.loads((out / "summary.json").read_text())
    if kind == "pick":
        count = round(summary["metrics"]["success"] * _EXPERT_EPISODES)
        success = asdict(rate([True] * count + [False] * (_EXPERT_EPISODES - count)))
    else:
        success = summary["eval"]["success"]
    return {
        "seed": seed,
        "env_steps": summary["env_steps"],
        "cpu_seconds": round(cpu, 1),
        "success": success["rate"],
        "interval": success["interval"],
    }


def run(folder: str, *words: str) -> None:
    """Run a command of embodichain in a folder."""
    command = [sys.executable, "-m", "embodichain", *words]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)


def report(facts: list[dict[str, Any]]) -> str:
    """Return the table of the docs."""
    rows = []
    for row in facts:
        how = "expert" if row["kind"] == "pick" else f"{row['env_steps']:,} steps"
        rows.append(
            [row["kind"], f"`{row['robot']}`", how, f"{row['cpu_seconds']:.0f}", _share(row)]
        )
    return table(["kind", "robot", "by", "CPU seconds", "success"], rows)


def _share(row: Mapping[str, Any]) -> str:
    """A share of successes, with its 95 % interval."""
    share = f"{row['success']:.2f}"
    low, high = row["interval"]
    return f"{share} ({low:.2f} to {high:.2f})"


if __name__ == "__main__":
    main()
