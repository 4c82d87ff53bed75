"""Whether a robot of one's own learns at once: `python -m benchmarks.own_robot`.

For each robot `embodichain new task NAME --robot FILE`, then `embodichain train task=NAME seed=S`,
without an edit, as a newcomer types them.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.machine import table, write_json

ROBOTS = {
    "so101": "so_arm_description/urdf/so101.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "arm5": "arm5.xml",
}
ARM5 = """\
<mujoco model="arm5">
  <compiler angle="radian"/>
  <default>
    <joint damping="2" armature="0.05"/>
    <position kp="200" kv="20" forcerange="-60 60" ctrllimited="true"/>
  </default>
  <worldbody>
    <body name="base">
      <geom type="cylinder" size="0.06 0.05" pos="0 0 0.05" mass="3"/>
      <body name="turret" pos="0 0 0.1">
        <joint name="pan" axis="0 0 1" range="-2.9 2.9"/>
        <geom type="cylinder" size="0.05 0.04" pos="0 0 0.04" mass="1"/>
        <body name="upper" pos="0 0 0.08">
          <joint name="lift" axis="0 1 0" range="-1.8 1.8"/>
          <geom type="capsule" fromto="0 0 0.06 0 0 0.24" size="0.03" mass="1"/>
          <body name="fore" pos="0 0 0.3">
            <joint name="elbow" axis="0 1 0" range="-2.4 2.4"/>
            <geom type="capsule" fromto="0 0 0.06 0 0 0.19" size="0.025" mass="0.8"/>
            <body name="wrist" pos="0 0 0.25">
              <joint name="tilt" axis="0 1 0" range="-2 2"/>
              <geom type="capsule" fromto="0 0 0.05 0 0 0.07" size="0.02" mass="0.3"/>
              <body name="hand" pos="0 0 0.1">
                <joint name="roll" axis="0 0 1" range="-2.9 2.9"/>
                <geom type="box" size="0.02 0.04 0.02" pos="0 0 0.03" mass="0.2"/>
                <site name="tcp" pos="0 0 0.07"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pan" joint="pan" ctrlrange="-2.9 2.9"/>
    <position name="lift" joint="lift" ctrlrange="-1.8 1.8"/>
    <position name="elbow" joint="elbow" ctrlrange="-2.4 2.4"/>
    <position name="tilt" joint="tilt" ctrlrange="-2 2"/>
    <position name="roll" joint="roll" ctrlrange="-2.9 2.9"/>
  </actuator>
</mujoco>
"""
"""An arm of five joints with servos of its own, written for this measurement."""
WANTED = 0.95
"""Share of successful episodes, in two of three seeds at least."""


def main() -> None:
    """Train each robot with each seed, one after the other, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    facts: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "arm5.xml").write_text(ARM5)
        for name in options.robots:
            _embodichain(folder, "new", "task", name, "--robot", ROBOTS[name])
            facts[name] = [_trained(folder, name, seed) for seed in options.seeds]
            print(name, facts[name], file=sys.stderr, flush=True)
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def _trained(folder: str, name: str, seed: int) -> dict[str, float]:
    run = Path(folder, f"{name}_{seed}")
    words = ("train", f"task={name}", f"seed={seed}", f"hydra.run.dir={run}")
    start = time.perf_counter()
    _embodichain(folder, *words)
    seconds = time.perf_counter() - start
    summary = json.loads((run / "summary.json").read_text())
    return {"success": summary["eval"]["success"]["rate"], "seconds": round(seconds, 1)}


def _embodichain(folder: str, *words: str) -> None:
    command = [sys.executable, "-m", "embodichain", *words]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)


def report(facts: dict[str, Any]) -> str:
    """The table of the docs: share of successes by seed, and the longest command."""
    rows = []
    for name, trainings in facts.items():
        successes = [training["success"] for training in trainings]
        solved = sum(success >= WANTED for success in successes)
        shares = ", ".join(f"{success:.2f}" for success in successes)
        seconds = max(training["seconds"] for training in trainings)
        share = f"{solved} of {len(successes)}"
        rows.append([f"`{ROBOTS[name]}`", shares, share, f"{seconds:.0f}"])
    return table(["robot", "success by seed", f"at least {WANTED}", "seconds"], rows)


if __name__ == "__main__":
    main()
