"""What actions and quantities of tools and grippers cost: `python -m benchmarks.action_cost`.

CPU time of this thread for one call of each term, in turns within one process, beside a whole step
of `reach`. The robot is a UR10 with the gripper of this package. Forward kinematics of the state,
which all terms share, is computed before the clock starts.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from benchmarks import arms
from benchmarks.machine import table, write_json
from benchmarks.small_batches import THREAD, turns

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

SIZES = (1, 64, 1024)
ARM = "of: {uid: robot, joint_names: 'Joint.', link_names: [ee_link]}"
LEFT, RIGHT = "gripper/left_finger", "gripper/right_finger"
ACTIONS = {
    "relative_joint_position": "of: {uid: robot, joint_names: 'Joint.'}",
    "eef_delta_pose": ARM,
    "eef_delta_pose, world": f"{ARM}, frame: world",
    "eef_delta_pose, tool, measured": f"{ARM}, frame: tool, reference: qpos",
    "eef_pose": ARM,
    "eef_pose, world, rpy": f"{ARM}, frame: world, rotation: rpy",
    "parallel_gripper": "of: {uid: robot}, actuator_names: gripper/grip, width: [0, 0.085]",
    "parallel_gripper, force, speed": (
        "of: {uid: robot}, actuator_names: gripper/grip, width: [0, 0.085], force: 60, speed: 0.15"
    ),
}
"""Function of the term, a remark, and its parameters."""
QUANTITIES = {
    "gripper_opening": f"from: {{uid: robot, link_names: [{LEFT}]}}, "
    f"to: {{uid: robot, link_names: [{RIGHT}]}}",
    "grasped": "sensor: fingers",
}
STEP = "whole step of reach"


def main() -> None:
    """Measure every size and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--calls", type=int, default=300, help="calls of a turn at N=1")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    torch.set_num_threads(1)
    facts = {
        "rounds": options.rounds,
        "microseconds": {
            size: measured(size, options.rounds, max(4, options.calls // (1 + size // 64)))
            for size in options.sizes
        },
    }
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def overrides() -> list[str]:
    """Changes of `reach`: the gripper, a sensor on its fingers, the terms."""
    gripper = "{fpath: ParallelGripper/parallel_gripper.xml, to: ee_link}"
    sensor = f"entity_cfg: {{uid: robot, link_names: [{LEFT}, {RIGHT}]}}, against: {{uid: goal}}"
    given = [
        THREAD,
        f"+task.robot.attach={{gripper: {gripper}}}",
        "~task.actions.arm",
        "task.objects.goal.attrs.enable_collision=true",
        f"+task.sensors.fingers={{sensor_type: contact, {sensor}}}",
    ]
    for section, terms in (("actions", ACTIONS), ("observations", QUANTITIES)):
        for number, (name, params) in enumerate(terms.items()):
            func = name.partition(",")[0]
            given.append(f"+task.{section}.t{number}={{func: {func}, params: {{{params}}}}}")
    return given


def measured(size: int, rounds: int, count: int) -> dict[str, list[float]]:
    """CPU microseconds a call of each term, and of a step of `reach`; one figure a round."""
    env, plain = arms.make("reach", size, *overrides()), arms.make("reach", size, THREAD)
    env.reset(seed=0), plain.reset(seed=0)
    still = torch.zeros(plain.action_space.shape)
    calls: dict[str, Callable[[], object]] = {STEP: partial(plain.step, still)}
    for number, name in enumerate(ACTIONS):
        calls[name] = acting(env, f"t{number}")
    for number, name in enumerate(QUANTITIES):
        calls[name] = partial(env.observation_manager.terms[f"t{number}"].call, env)
    found = turns(calls, rounds, count)
    env.close(), plain.close()
    return found


def acting(env: BaseEnv, name: str) -> Callable[[], object]:
    """A call of an action term: around its home action, and back the same way."""
    term = env.action_manager.terms[name]
    home = np.broadcast_to(term.instance.home(), (env.num_envs, len(term.instance.low)))
    noise = np.random.default_rng(0).uniform(-0.05, 0.05, (8, *home.shape))
    given = [torch.tensor(home + part, dtype=torch.float32) for part in (*noise, *-noise)]
    numbers = iter(range(10**9))
    return lambda: term.call(given[next(numbers) % len(given)])


def report(facts: dict[str, Any]) -> str:
    """A Markdown table: terms by size."""
    found = facts["microseconds"]
    sizes = list(found)
    rows = [
        [name, *(f"{median(found[size][name]):.0f}" for size in sizes)] for name in found[sizes[0]]
    ]
    return "Microseconds of CPU time a call:\n\n" + table(
        ["term", *(f"N={size}" for size in sizes)], rows
    )


if __name__ == "__main__":
    main()
