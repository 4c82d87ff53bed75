"""Armature that is added where drives would chatter, or joints that mimic others would lag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Mask
from embodichain.lab.sim.compiler.robot.drives.chatter import PhysicsStep, quiet_armature
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange, drawn_joints
from embodichain.lab.sim.compiler.robot.drives.pd_drives import DriveGains
from embodichain.lab.sim.compiler.robot.drives.rigid_couplings import moving_mimics, rigid_armature
from embodichain.lab.sim.compiler.robot.files.joint_couplings import JointCoupling

__all__ = ["RAISED", "add_armature", "rounded"]

RAISED = "is raised"
"""Words of the message about added armature."""


def add_armature(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    names: Sequence[str],
    gains: DriveGains,
    mimics: Sequence[JointCoupling],
    home: F64,
    parts: Mapping[str, Sequence[int]],
    step: PhysicsStep,
    changes: Sequence[DriveChange],
) -> tuple[F64, list[str]]:
    """Raise armature that the config does not give, in a spec and its model.

    Returns:
        (D,) added armature, and messages for the user.
    """
    lacking_for_quiet = quiet_armature(model, names, gains, home, parts, step, changes)
    lacking = lacking_for_quiet
    if mimics:
        rigid = moving_mimics(model, names, mimics)
        lacking = quiet_armature(model, names, gains, home, parts, step, changes, rigid)
        lacking = rigid_armature(model, names, gains, mimics, home, step, lacking)
    # Armature that the config gives, or that events draw, is the user's: a message says if it is
    # too small.
    is_given = gains.armature_given | drawn_joints("armature", names, parts, changes)
    added = np.where(is_given, 0.0, lacking)
    for i in np.flatnonzero(added > 0).tolist():
        total = float(rounded(gains.armature + added)[i])
        spec.joint(names[i]).armature = total
        model.dof_armature[model.joint(names[i]).dofadr[0]] = total
    if added.any():
        mujoco.mj_setConst(model, mujoco.MjData(model))

    reason = "limited drives would chatter"
    if not (lacking_for_quiet > 0).any():
        reason = "joints that mimic others would not follow them"
    elif (lacking > lacking_for_quiet).any():
        reason += ", and joints that mimic others would not follow them,"
    reason += f" at a time step of {step.dt:g} s"
    enough = gains.armature + lacking
    notes = (
        _armature_note(RAISED, reason, names, enough, added > 0),
        _armature_note("is too small", reason, names, enough, is_given & (lacking > 0)),
    )
    return added, [note for note in notes if note]


def rounded(values: F64) -> F64:
    """Round to 12 decimals, as a config that gives the armature has."""
    return np.array([round(float(value), 12) for value in values])


def _armature_note(
    what: str, reason: str, names: Sequence[str], enough: F64, concerned: Mask
) -> str:
    """Return a message about the joints that it concerns; empty if there are none."""
    if not concerned.any():
        return ""
    values = ", ".join(f"{names[i]}: {enough[i]:.4g}" for i in np.flatnonzero(concerned).tolist())
    return f"drive_pros.armature {what}: {reason}; enough is {{{values}}}"
