"""`quiet_armature`: the armature with which drives that have an effort limit do not chatter.

A drive's force is ``clip(kp (target - q) - kd v, -limit, limit)``. MuJoCo integrates its damper
implicitly, but not where the force is clipped: there a step changes the velocity by ``h M^-1 f``.
A clipped force that reverses it in one step is clipped in the next as well: the joint chatters.

For one joint the condition follows from the cycle of two steps, q = target -+ h v / 2 at +-v with
v = h limit / 2 M: its force is clipped, so that the cycle persists, exactly if
M < h kd / 2 + h^2 kp / 4. Several joints chatter together where the matrix
M(q) - diag(h kd / 2 + h^2 kp / 4) is not positive semidefinite. Passive damping and dry friction
only reduce chatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.lab.sim.compiler.index import F64, Ids, Mask
from embodichain.lab.sim.compiler.robot.drives.drive_changes import (
    DriveChange,
    Parts,
    extreme_values,
)
from embodichain.lab.sim.compiler.robot.drives.pd_drives import DriveGains
from embodichain.utils.random import RandomStreams

__all__ = ["PhysicsStep", "inertia_matrix", "physics_step", "quiet_armature", "round_up"]

_IMPLICIT = ("implicitfast", "implicit")
"""Integrators that take a damper implicitly, as long as its force is not clipped."""
_POSTURES = 256
_TOLERANCE = 1e-3
"""Share of the needed inertia; smaller needs are ignored."""
_ROUNDS = 64  # arms take three to five, a humanoid of 32 limited joints nine


@dataclass(frozen=True)
class PhysicsStep:
    """Time step in seconds and integrator, on which chatter depends."""

    dt: float = 0.01
    integrator: str = "implicitfast"


def physics_step(cfg: SimulationManagerCfg) -> PhysicsStep:
    """Return the time step and integrator of a simulation."""
    return PhysicsStep(float(cfg.physics_dt), cfg.physics_config.integrator)


def quiet_armature(
    model: mujoco.MjModel,
    names: Sequence[str],
    gains: DriveGains,
    home: F64,
    parts: Parts,
    step: PhysicsStep,
    changes: Sequence[DriveChange] = (),
    rigid: Mask | None = None,
) -> F64:
    """Return the armature (D,) that each joint lacks to avoid chatter, rounded up to two digits.

    The joint-space inertia is computed at `home`, at qpos0 and at 256 fixed postures within the
    limits (within [-pi, pi] without limits). The floating base and undriven joints move freely.

    Args:
        model: The articulation alone, with its current armature.
        names: Its D hinges and slides.
        gains: Their drives.
        home: (D,) initial positions.
        parts: See `DriveChange.names`.
        step: Time step and integrator. With Euler and RK4, which take the damper explicitly, drives
            without a limit count too.
        changes: Values that events may draw; the largest gains and the smallest mass count.
        rigid: (D,) drives that count without a limit too, see `couplings`.
    """
    missing = np.zeros(len(names))
    need = _needed_inertia(gains, names, parts, step, changes, rigid)
    joints = np.flatnonzero(need > 0)
    if not len(joints):
        return missing
    dofs = np.array([model.joint(name).dofadr[0] for name in names], np.int64)
    inertia = _least_inertias(model, names, dofs, home, parts, changes)
    # Effective inertia of driven joints while the others move freely: the Schur complement.
    driven = np.ix_(np.arange(len(inertia)), dofs[joints], dofs[joints])
    effective_inertia = np.linalg.inv(np.linalg.inv(inertia)[driven])
    added = _missing_inertia(effective_inertia, need[joints])
    added[added < _TOLERANCE * need[joints]] = 0.0
    for joint, value in zip(joints.tolist(), added.tolist(), strict=True):
        if value > 0:
            missing[joint] = round_up(value)
    return missing


def _needed_inertia(
    gains: DriveGains,
    names: Sequence[str],
    parts: Parts,
    step: PhysicsStep,
    changes: Sequence[DriveChange],
    rigid: Mask | None,
) -> F64:
    """(D,) inertia below which each drive chatters; 0 where it cannot. See `quiet_armature`."""

    def largest(quantity: str, default: F64) -> F64:
        return extreme_values(quantity, default, changes, names=names, parts=parts, choose=max)

    strength = largest("strength", np.ones(len(names)))
    kp = largest("stiffness", np.where(gains.driven, gains.stiffness, 0.0)) * strength
    kd = largest("damping", np.where(gains.driven, gains.damping, 0.0)) * strength
    smallest_limit = extreme_values(
        "max_effort", gains.max_effort, changes, names=names, parts=parts, choose=min
    )
    may_chatter = np.isfinite(smallest_limit)
    if step.integrator not in _IMPLICIT:
        may_chatter[:] = True
    if rigid is not None:
        may_chatter |= rigid
    return np.where(may_chatter, 0.5 * step.dt * kd + 0.25 * step.dt**2 * kp, 0.0)


def _least_inertias(
    model: mujoco.MjModel,
    names: Sequence[str],
    dofs: Ids,
    home: F64,
    parts: Parts,
    changes: Sequence[DriveChange],
) -> F64:
    """(P, nv, nv) inertia matrices at the postures, with the least that events may draw.

    Args:
        model: The articulation alone.
        names: Its D joints.
        dofs: (D,) their columns in qvel.
        home: (D,) initial positions.
        parts: See `DriveChange.names`.
        changes: Values that events may draw.
    """
    armature = model.dof_armature
    least_armature = armature.copy()
    least_armature[dofs] = extreme_values(
        "armature", armature[dofs], changes, names=names, parts=parts, choose=min
    )
    # The matrix is a sum over links: scaling it by the smallest mass factor gives a lower bound.
    mass = model.body_mass[1:]
    links = [model.body(i).name for i in range(1, model.nbody)]
    least_mass = extreme_values("mass", mass, changes, names=links, parts={}, choose=min)
    has_mass = mass > 0
    factors = least_mass[has_mass] / mass[has_mass]
    least_factor = float(np.clip(factors, 0.0, 1.0).min(initial=1.0))
    inertia = _inertias(model, dofs, home) - np.diag(armature)
    return inertia * least_factor + np.diag(least_armature)


def _missing_inertia(inertia: F64, need: F64) -> F64:
    """Return a >= 0 (D,) with inertia (P, D, D) + diag(a - need) positive semidefinite everywhere.

    Each diagonal element is raised first. Then the coupling of joints is compensated along the
    worst eigenvector, in shares that cancel the negative eigenvalue, until none is left (within a
    thousandth of `need`).
    """
    diagonal = inertia[:, range(len(need)), range(len(need))]
    added: F64 = np.maximum(0.0, need - diagonal.min(axis=0))
    tolerance = _TOLERANCE * float(need.max())
    postures = inertia
    for _ in range(_ROUNDS):
        values, vectors = np.linalg.eigh(postures + np.diag(added - need))
        worst = int(values[:, 0].argmin())
        if values[worst, 0] >= -tolerance:
            if postures is inertia:
                return added
            postures = inertia  # check the postures that passed again
            continue
        share = np.abs(vectors[worst, :, 0])
        added += -values[worst, 0] * share * share.sum()
        postures = postures[values[:, 0] < -tolerance]
    return np.maximum(added, need)


def _inertias(model: mujoco.MjModel, dofs: Ids, home: F64) -> F64:
    """(P, nv, nv) joint-space inertia matrices at qpos0, at `home` and at drawn postures."""
    joints = model.dof_jntid[dofs]
    columns = model.jnt_qposadr[joints]
    is_limited = model.jnt_limited[joints].astype(np.bool_)
    low, high = np.where(is_limited, model.jnt_range[joints].T, [[-math.pi], [math.pi]])
    drawn = RandomStreams(0, _POSTURES).uniform("postures", (len(dofs),), low, high)
    postures = np.tile(model.qpos0, (_POSTURES + 2, 1))
    postures[1, columns] = home
    postures[2:, columns] = drawn
    matrices = np.zeros((len(postures), model.nv, model.nv))
    data = mujoco.MjData(model)
    for number, qpos in enumerate(postures):
        data.qpos[:] = qpos
        matrices[number] = inertia_matrix(model, data)
    return matrices


def inertia_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> F64:
    """(nv, nv) joint-space inertia matrix at `data.qpos`, armature included."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_makeM(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix


def round_up(value: float) -> float:
    """Round a positive number up to two significant digits."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / digit - 1e-9) * digit:.2g}")
