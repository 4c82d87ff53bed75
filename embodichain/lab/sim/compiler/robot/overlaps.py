"""`overlapping_links`: links of a robot that are in each other in many postures."""

from __future__ import annotations

import mujoco

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.robot.contacts.link_siblings import Pair
from embodichain.lab.sim.compiler.robot.contacts.postures import (
    DEPTH,
    POSTURES,
    deepest_contacts,
    draw_postures,
    start_posture,
)
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation

__all__ = ["overlapping_links"]

_SHARE = 0.05


def overlapping_links(parsed: ParsedArticulation) -> dict[tuple[str, str], float]:
    """Return pairs of links that collide and overlap in many postures -> share of the postures.

    These are hulls that are larger than what they stand for, or real limits of the robot. Pairs
    that the config names in `self_collision.include` are left out.

    Args:
        parsed: The robot.

    Returns:
        Pairs that are more than 1 mm in each other in more than 5 % of 200 fixed postures, the
        most frequent first.
    """
    model = parsed.model
    data = mujoco.MjData(model)
    start = start_posture(model, parsed.init_qpos, parsed.keyframe)
    columns = [int(model.joint(name).qposadr[0]) for name in parsed.joint_names]
    counts: dict[Pair, int] = {}
    for qpos in draw_postures(model, start):
        qpos[columns] = _with_followers(parsed, qpos[columns])
        for pair, depth in deepest_contacts(model, data, qpos).items():
            if pair[0] and depth > DEPTH:
                counts[pair] = counts.get(pair, 0) + 1
    often = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    named = {
        (model.body(a).name, model.body(b).name): n / POSTURES
        for (a, b), n in often
        if n > _SHARE * POSTURES
    }
    return {k: v for k, v in named.items() if k not in parsed.self_collision.included}


def _with_followers(parsed: ParsedArticulation, qpos: F64) -> F64:
    """Set joints that follow others; a chain of them is followed to its end."""
    rules = [
        *zip(
            parsed.mimic_ids,
            parsed.mimic_parents,
            parsed.mimic_multipliers,
            parsed.mimic_offsets,
            strict=True,
        )
    ]
    for _ in range(len({*parsed.mimic_ids} & {*parsed.mimic_parents}) + 1):
        for follower, leader, multiplier, offset in rules:
            qpos[follower] = multiplier * qpos[leader] + offset
    return qpos
