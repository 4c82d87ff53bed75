"""Armature that is added where drives would chatter, or joints that mimic others would lag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Mask
from embodichain.lab.sim.compiler.robot.drives.couplings import moving_mimics, rigid_armature
from embodichain.lab.sim.compiler.robot.drives.pd_drives import (
    DriveChange,
    DriveGains,
    PhysicsStep,
    drawn_joints,
    quiet_armature,
)
from embodichain.lab.sim.compiler.robot.files.robot_joints import Mimics

__all__ = ["RAISED", "add_armature", "rounded"]

RAISED = "is raised"
"""Words of the message about added armature."""


def add_armature(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    names: Sequence[str],
    gains: DriveGains,
    mimics: Mimics,
    home: F64,
    parts: Mapping[str, Sequence[int]],
    step: PhysicsStep,
    changes: Sequence[DriveChange],
) -> tuple[F64, list[str]]:
    """Raise armature that the config does not give, in a spec and its model.

    Returns:
        (D,) added armature, and messages for the user.
    """
    quiet = quiet_armature(model, names, gains, home, parts, step, changes)
    lacking = quiet
    if mimics.ids:
        rigid = moving_mimics(model, names, mimics)
        lacking = quiet_armature(model, names, gains, home, parts, step, changes, rigid)
        lacking = rigid_armature(model, names, gains, mimics, home, step, lacking)
    given = gains.armature_given | drawn_joints("armature", names, parts, changes)
    added = np.where(given, 0.0, lacking)
    for i in np.flatnonzero(added > 0).tolist():
        total = float(rounded(gains.armature + added)[i])
        spec.joint(names[i]).armature = total
        model.dof_armature[model.joint(names[i]).dofadr[0]] = total
    if added.any():
        mujoco.mj_setConst(model, mujoco.MjData(model))
    enough = gains.armature + lacking
    why = "limited drives would chatter"
    if not (quiet > 0).any():
        why = "joints that mimic others would not follow them"
    elif (lacking > quiet).any():
        why += ", and joints that mimic others would not follow them,"
    notes = (
        _armature_note(RAISED, names, enough, added > 0, why, step),
        _armature_note("is too small", names, enough, given & (lacking > 0), why, step),
    )
    return added, [note for note in notes if note]


def rounded(values: F64) -> F64:
    """Round to 12 decimals, as a config that gives the armature has."""
    return np.array([round(float(value), 12) for value in values])


def _armature_note(
    what: str, names: Sequence[str], enough: F64, joints: Mask, why: str, step: PhysicsStep
) -> str:
    listed = ", ".join(f"{names[i]}: {enough[i]:.4g}" for i in np.flatnonzero(joints).tolist())
    because = f"{why} at a time step of {step.dt:g} s"
    return f"drive_pros.armature {what}: {because}; enough is {{{listed}}}" if listed else ""
