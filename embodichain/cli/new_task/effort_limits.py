"""`guess_effort_limits`: how hard drives may push where a robot's file does not tell."""

from __future__ import annotations

import json
import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.guesses import some_of
from embodichain.lab.sim.configs.drive_cfg import NO_LIMIT

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation

__all__ = ["EffortLimits", "guess_effort", "guess_effort_limits"]

_GRAVITY = 9.81
"""m/s^2."""
_WEIGHTS = 2.0
"""How often a drive can hold the weight of what it carries, stretched out."""
_LARGEST_ERROR = 0.1
"""Error in rad or m up to which a drive's stiffness is not cut off."""


@dataclass(frozen=True)
class EffortLimits:
    """The effort limits of a robot's drives.

    Attributes:
        value: `max_effort` of `drive_pros` as YAML.
        why: What it was guessed from; empty where all limits are the file's.
    """

    value: str
    why: str = ""


def guess_effort_limits(
    parsed: ParsedArticulation, stiffness: float, zero_effort: Collection[str]
) -> EffortLimits:
    """Return the file's effort limits, with guesses for the drives that have none in it.

    A drive without a limit gets no armature, see `compiler.robot.drives.chatter`. The damping of
    such a drive on a light link is large beside the link's inertia, and contacts do not know of
    it: what is gripped slips.

    Args:
        parsed: The robot.
        stiffness: Of its drives, N m/rad or N/m.
        zero_effort: Joints whose effort limit in the file is 0.
    """
    limits: dict[str, float] = {}
    guessed_names: list[str] = []
    for i, name in enumerate(parsed.joint_names):
        if i in parsed.mimic_ids:
            continue
        limits[name] = float(parsed.qf_limits[i])
        if limits[name] >= NO_LIMIT:
            limits[name] = guess_effort(parsed.model, name, stiffness)
            guessed_names.append(name)
    if not guessed_names:
        return EffortLimits("file")
    value = f"{next(iter(limits.values())):g}"
    if len(set(limits.values())) > 1:
        entries = [f"{json.dumps(re.escape(name))}: {limit:g}" for name, limit in limits.items()]
        value = f"{{{', '.join(entries)}}}"
    lack = "has no effort limits"
    if zero_effort:
        lack = "has efforts of 0, which are no limits"
    why = (
        f"max_effort: the file {lack} ({some_of(guessed_names)}); {_WEIGHTS:g} times the weight "
        f"that a joint carries, stretched out, but no less than {_LARGEST_ERROR:g} of the stiffness"
    )
    return EffortLimits(value, why)


def guess_effort(model: mujoco.MjModel, joint: str, stiffness: float) -> float:
    """Return a limit for the drive of one joint, N m or N, with two digits."""
    weight = _WEIGHTS * _carried_weight(model, joint)
    return float(f"{max(weight, _LARGEST_ERROR * stiffness):.2g}")


def _carried_weight(model: mujoco.MjModel, joint: str) -> float:
    """The largest torque in N m about a hinge, or force in N along a slide, of the links beyond.

    They are taken as if they were stretched out in a horizontal line.
    """
    import mujoco

    first_body = int(model.jnt_bodyid[model.joint(joint).id])
    is_hinge = model.jnt_type[model.joint(joint).id] == mujoco.mjtJoint.mjJNT_HINGE
    distance = {first_body: 0.0}
    weight = 0.0
    for body in range(first_body, model.nbody):  # parents come before children
        parent = int(model.body_parentid[body])
        if body != first_body:
            if parent not in distance:
                continue
            distance[body] = distance[parent] + float(np.linalg.norm(model.body_pos[body]))
        lever = 1.0
        if is_hinge:
            lever = distance[body] + float(np.linalg.norm(model.body_ipos[body]))
        weight += _GRAVITY * float(model.body_mass[body]) * lever
    return weight
