"""Chatter of force-limited drives, and the smallest armature that prevents it.

A drive's force is ``clip(kp (target - q) - kd v, -limit, limit)``. MuJoCo integrates its damper
implicitly, but not where the force is clipped: there a step changes the velocity by
``h M^-1 force``, whatever the velocity is. A clipped force that reverses the velocity within one
step is clipped again in the next one, and the joint jumps back and forth for ever.

For one joint the condition follows from the cycle of two steps, q = target -+ h v / 2 at +-v with
v = h limit / 2 M: its force is clipped, so that it can go on, exactly if M < h kd / 2 + h^2 kp / 4.
Several joints chatter together where the matrix M(q) - diag(h kd / 2 + h^2 kp / 4) is not positive
semidefinite; single joints of an arm pass the test that their arm fails. Passive damping and dry
friction, which only help, are left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.lab.sim.compiler.index import F64
from embodichain.utils.random import RandomStreams

__all__ = [
    "DriveChange",
    "PhysicsStep",
    "drawn_joints",
    "physics_step",
    "quiet_armature",
]

_POSTURES = 256
_IMPLICIT = ("implicitfast", "implicit")
_TOLERANCE = 1e-3
"""Of what is needed: less is not worth a number."""
_ROUNDS = 64
"""Arms take three to five, a humanoid of 32 limited joints nine."""


@dataclass(frozen=True)
class PhysicsStep:
    """What chatter depends on besides the robot: time step in seconds and integrator."""

    dt: float = 0.01
    integrator: str = "implicitfast"


def physics_step(cfg: SimulationManagerCfg) -> PhysicsStep:
    """The time step and integrator of a simulation."""
    return PhysicsStep(float(cfg.physics_dt), cfg.physics_config.integrator)


@dataclass(frozen=True)
class DriveChange:
    """What an event may draw for the drives or links of one articulation.

    Attributes:
        quantity: What is drawn; ``strength`` multiplies gains and limit.
        names: Regexes or control parts that pick joints (links of ``mass``); None picks all.
        ranges: (low, high) for all that are picked, or by regex.
        operation: ``abs`` replaces the compiled value, ``scale`` and ``add`` change it.
    """

    quantity: Literal["stiffness", "damping", "max_effort", "strength", "armature", "mass"]
    names: tuple[str, ...] | None
    ranges: tuple[float, float] | Mapping[str, tuple[float, float]]
    operation: Literal["abs", "scale", "add"] = "abs"


def quiet_armature(
    model: mujoco.MjModel,
    joint_names: Sequence[str],
    *,
    stiffness: F64,
    damping: F64,
    max_effort: F64,
    home: F64,
    parts: Mapping[str, Sequence[int]],
    step: PhysicsStep,
    changes: Sequence[DriveChange] = (),
) -> F64:
    """Return the armature (D,) that each joint lacks to be quiet, rounded up to two digits.

    The joint-space inertia is that at `home`, at qpos0 and at 256 postures within the limits (of
    [-pi, pi] without one), always the same; its floating base and undriven joints move freely.

    Args:
        model: The articulation alone, with the armature that it has.
        joint_names: Its D hinges and slides.
        stiffness: (D,) of the drives; 0 without one.
        damping: (D,) of the drives; 0 without one.
        max_effort: (D,) limits of the drives, infinite without one.
        home: (D,) initial positions.
        parts: Control parts, joint indices each.
        step: Time step and integrator. With Euler and RK4, which take the damper explicitly, drives
            without a limit count too.
        changes: What events may draw; the largest gains and the smallest mass count.
    """
    dofs = np.array([model.joint(name).dofadr[0] for name in joint_names], np.int64)

    def drawn(quantity: str, default: F64, most: bool) -> F64:
        return _extreme(default, quantity, joint_names, parts, changes, most=most)

    strength = drawn("strength", np.ones(len(dofs)), True)
    kp = drawn("stiffness", stiffness, True) * strength
    kd = drawn("damping", damping, True) * strength
    limited = np.isfinite(drawn("max_effort", max_effort, False))
    if step.integrator not in _IMPLICIT:
        limited[:] = True
    need = np.where(limited, 0.5 * step.dt * kd + 0.25 * step.dt**2 * kp, 0.0)
    lacking = np.zeros(len(dofs))
    joints = np.flatnonzero(need > 0)
    if not len(joints):
        return lacking
    armature = model.dof_armature.copy()
    least = armature.copy()
    least[dofs] = drawn("armature", armature[dofs], False)
    inertia = _inertias(model, dofs, home) - np.diag(armature)
    inertia = inertia * _lightest(model, changes) + np.diag(least)
    # What the driven joints feel while the others are free to move: the Schur complement.
    picked = np.ix_(np.arange(len(inertia)), dofs[joints], dofs[joints])
    felt = np.linalg.inv(np.linalg.inv(inertia)[picked])
    added = _added(felt, need[joints])
    added[added < _TOLERANCE * need[joints]] = 0.0
    lacking[joints] = [_round_up(x) for x in added]
    return lacking


def drawn_joints(
    quantity: str,
    names: Sequence[str],
    parts: Mapping[str, Sequence[int]],
    changes: Sequence[DriveChange],
) -> NDArray[np.bool_]:
    """(D,) which joints have a quantity that events draw."""
    found = np.zeros(len(names), np.bool_)
    for change in changes:
        if change.quantity == quantity:
            found[list(_bounds(change, names, parts))] = True
    return found


def _added(inertia: F64, need: F64) -> F64:
    """Return a >= 0 with inertia + diag(a - need) positive semidefinite at every posture.

    A joint's own inertia must suffice; what the coupling of joints takes from it is added along the
    worst eigenvector, in shares that cancel the negative eigenvalue, until none is left (to a
    thousandth of `need`).

    Args:
        inertia: (P, D, D).
        need: (D,).
    """
    own = inertia[:, range(len(need)), range(len(need))].min(axis=0)
    added: F64 = np.maximum(0.0, need - own)
    tolerance = _TOLERANCE * float(need.max())
    wrong = inertia
    for _ in range(_ROUNDS):
        values, vectors = np.linalg.eigh(wrong + np.diag(added - need))
        worst = int(values[:, 0].argmin())
        if values[worst, 0] >= -tolerance:
            if wrong is inertia:
                return added
            wrong = inertia  # what was right need not be looked at in every round
            continue
        share = np.abs(vectors[worst, :, 0])
        added += -values[worst, 0] * share * share.sum()
        wrong = wrong[values[:, 0] < -tolerance]
    return np.maximum(added, need)


def _inertias(model: mujoco.MjModel, dofs: NDArray[np.int64], home: F64) -> F64:
    """(P, nv, nv) joint-space inertia matrices at the postures."""
    joints = model.dof_jntid[dofs]
    columns = model.jnt_qposadr[joints]
    limited = model.jnt_limited[joints].astype(np.bool_)
    low = np.where(limited, model.jnt_range[joints, 0], -math.pi)
    high = np.where(limited, model.jnt_range[joints, 1], math.pi)
    random = RandomStreams(0, _POSTURES).uniform("postures", (len(dofs),), low, high)
    postures = np.tile(model.qpos0, (_POSTURES + 2, 1))
    postures[1, columns] = home
    postures[2:, columns] = random
    found = np.zeros((len(postures), model.nv, model.nv))
    data = mujoco.MjData(model)
    for qpos, matrix in zip(postures, found, strict=True):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_fullM(model, data, matrix)
    return found


def _extreme(
    default: F64,
    quantity: str,
    names: Sequence[str],
    parts: Mapping[str, Sequence[int]],
    changes: Sequence[DriveChange],
    *,
    most: bool,
) -> F64:
    """The largest (or smallest) values that events may give a quantity; the default counts too."""
    pick = max if most else min
    found = default.copy()
    for change in changes:
        if change.quantity != quantity:
            continue
        for i, bounds in _bounds(change, names, parts).items():
            values = [_applied(change, float(default[i]), bound) for bound in bounds]
            found[i] = pick(float(found[i]), *values)
    return found


def _lightest(model: mujoco.MjModel, changes: Sequence[DriveChange]) -> float:
    """The smallest factor that events may give the mass of a link.

    The inertia matrix is a sum over links, so that scaling all of it by this is a lower bound.
    """
    names = [model.body(i).name for i in range(1, model.nbody)]
    mass = model.body_mass[1:]
    least = _extreme(mass, "mass", names, {}, changes, most=False)
    heavy = mass > 0
    return float(np.clip(least[heavy] / mass[heavy], 0.0, 1.0).min(initial=1.0))


def _bounds(
    change: DriveChange, names: Sequence[str], parts: Mapping[str, Sequence[int]]
) -> dict[int, tuple[float, float]]:
    picked = range(len(names)) if change.names is None else _picked(change.names, names, parts)
    if not isinstance(change.ranges, Mapping):
        return dict.fromkeys(picked, change.ranges)
    return {
        i: bounds
        for pattern, bounds in change.ranges.items()
        for i in picked
        if re.fullmatch(pattern, names[i])
    }


def _picked(
    patterns: Sequence[str], names: Sequence[str], parts: Mapping[str, Sequence[int]]
) -> list[int]:
    found: list[int] = []
    for pattern in patterns:
        hits = [i for i, name in enumerate(names) if re.fullmatch(pattern, name)]
        found += parts.get(pattern, hits)
    return found


def _applied(change: DriveChange, default: float, bound: float) -> float:
    if change.operation == "abs":
        return bound
    return default * bound if change.operation == "scale" else default + bound


def _round_up(value: float) -> float:
    """The next number with two significant digits."""
    if value <= 0:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / digit - 1e-9) * digit:.2g}")
