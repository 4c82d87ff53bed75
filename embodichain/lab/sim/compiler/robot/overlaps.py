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

_LEAST_SHARE = 0.05
"""Share of the postures above which two links overlap often."""


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
    shares: dict[tuple[str, str], float] = {}
    for (a, b), count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        names = (model.body(a).name, model.body(b).name)
        is_frequent = count > _LEAST_SHARE * POSTURES
        if is_frequent and names not in parsed.self_collision.included:
            shares[names] = count / POSTURES
    return shares


def _with_followers(parsed: ParsedArticulation, qpos: F64) -> F64:
    """Set joints that follow others; a chain of them is followed to its end."""
    followers_that_lead = {*parsed.mimic_ids} & {*parsed.mimic_parents}
    for _ in range(len(followers_that_lead) + 1):
        for number, follower in enumerate(parsed.mimic_ids):
            leader = parsed.mimic_parents[number]
            multiplier = parsed.mimic_multipliers[number]
            qpos[follower] = multiplier * qpos[leader] + parsed.mimic_offsets[number]
    return qpos
