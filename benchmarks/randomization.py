"""What randomizing model fields costs: `python -m benchmarks.randomization`.

push_cube with episodes of 100 steps, without and with eight model fields drawn anew at every reset.
Environments that begin together are all reset in one step; staggered ones a few in every step.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks import arms
from benchmarks.arms import Arm
from benchmarks.machine import table, write_json
from benchmarks.rounds import EPISODE, Result, measure

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

SIZES = (64, 1024)
LIMIT = 0.10
FIELDS = (
    *("actuator_biasprm", "actuator_gainprm", "body_inertia", "body_ipos"),
    *("body_mass", "dof_armature", "actuator_biasprm", "geom_friction"),
)
"""What the events below write; constants that MuJoCo derives are recomputed as well."""
EVENTS = {
    "masses": "randomize_articulation_mass, params: {entity_cfg: {uid: robot}, "
    "mass_range: [0.8, 1.2], operation: scale}",
    "com": "randomize_rigid_object_center_of_mass, params: {entity_cfg: {uid: cube}, "
    "com_pos_offset_range: [[-0.01, -0.01, -0.01], [0.01, 0.01, 0.01]]}",
    "slide": "randomize_rigid_body_material, params: {entity_cfg: {uid: cube}, "
    "friction_range: [0.4, 0.8]}",
    "gains": "randomize_actuator_gains, params: {entity_cfg: {uid: robot}, "
    "stiffness_range: [0.8, 1.2], damping_range: [0.8, 1.2], operation: scale}",
    "armature": "randomize_joint_parameters, params: {entity_cfg: {uid: robot}, "
    "armature_range: [0.0, 0.1]}",
}
RANDOMIZED = [f"+task.events.{key}={{mode: reset, func: {term}}}" for key, term in EVENTS.items()]


def main() -> None:
    """Measure, print the table, write the raw figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=0.5, help="about how long a turn is")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--episode", type=int, default=EPISODE, help="steps of an episode")
    parser.add_argument("--out", type=Path, help="JSON file for the raw figures")
    options = parser.parse_args()
    with ExitStack() as stack:
        built: list[Arm] = []
        for size in options.sizes:
            for staggered in (False, True):
                built += pair(size, options.episode, staggered)
        for arm in built:
            stack.callback(arm.close)
        results = measure(built, options.rounds, options.seconds, options.episode)
    facts = {"rounds": options.rounds, "results": [result.facts() for result in results]}
    print(report(facts))
    if options.out:
        write_json(options.out, facts)


def pair(size: int, episode: int, staggered: bool) -> list[Arm]:
    """push_cube without and with randomization, the former being the latter's floor.

    Raises:
        RuntimeError: If the events do not write `FIELDS`.
    """
    when = "staggered" if staggered else "together"
    length = f"task.max_episode_steps={episode}"
    plain = arms.make("push_cube", size, length)
    mixed = arms.make("push_cube", size, length, *RANDOMIZED)
    built = [
        arms.environment(plain, f"plain, {when}", f"plain, {when}"),
        arms.environment(mixed, f"randomized, {when}", f"plain, {when}"),
    ]
    model = mixed.sim.engine.state_dict()["model"]
    if missing := set(FIELDS) - model.keys():
        raise RuntimeError(f"not randomized: {', '.join(sorted(missing))}")
    if staggered:
        for env in (plain, mixed):
            _stagger(env, episode)
    return built


def _stagger(env: BaseEnv, episode: int) -> None:
    """Begin environments' episodes one after the other, spread over the length of one."""
    import numpy as np
    import torch

    action = torch.from_numpy(arms.actions_for(env)[0])
    for step in range(episode):
        ids = np.arange(env.num_envs)
        due = ids[ids * episode // env.num_envs == step]
        if len(due):
            env.reset(options={"reset_ids": due})
        env.step(action)


def report(facts: dict[str, Any]) -> str:
    """A Markdown table: control steps/s without and with, and the cost."""
    fields = Result.__dataclass_fields__
    results = [Result(**{name: found[name] for name in fields}) for found in facts["results"]]
    by = {(result.name, result.num_envs): result for result in results}
    rows = []
    for name, size in by:
        if not name.startswith("randomized"):
            continue
        mixed = by[name, size]
        plain = by[mixed.floor, size]
        costs = sorted(1 - ratio for ratio in mixed.ratios)
        middle = f"{costs[len(costs) // 2]:.1%} [{costs[0]:.1%} to {costs[-1]:.1%}]"
        speeds = [f"{result.speed / 1000:.1f}k" for result in (plain, mixed)]
        rows.append([f"N={size}, {name.split(', ')[1]}", *speeds, middle, f"{LIMIT:.0%}"])
    return table(["resets", "without", "with", "cost", "at most"], rows)


if __name__ == "__main__":
    main()
