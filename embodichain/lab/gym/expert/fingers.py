"""`read_fingers`: which bodies a gripper moves, and along which line of the tool's frame.

They are read from the compiled model: a force that opens the gripper accelerates its fingers, and
those that equalities couple with them (mimic joints, tendons, closed loops of bars), while the
joints of the arm are held. So slides and hinges, joints and tendons need no case of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from embodichain.lab.gym.expert.arms import Arm, DeclaredArm, arms_of, find_arm
from embodichain.lab.gym.expert.instructions import Move
from embodichain.lab.gym.expert.program import check_steps
from embodichain.lab.gym.expert.reading import ReadStep
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.api import F64

    Ids = NDArray[np.int64]
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = ["Fingers", "check_fingers", "read_fingers", "unclear_fingers"]

_SPREAD = 0.03
"""Share of the squared speeds that may be across the direction: about 10 degrees."""
_FLAT = 0.01
"""Share of the squared speeds that must be across the tool's z axis, for slides to count."""
_RANK = 1e-6
"""Rows of constraints whose singular values are a smaller share of the largest add nothing."""
_COUPLED = 1e-9
"""Motion per motion of a joint (m or rad): a smaller one in a constraint leaves the joint alone."""
_STILL = 1e-6
"""Share of the fastest finger's speed below which a body does not move."""
_ROUNDED = 4
"""Decimals of the angle, in rad, so that it is the same whatever the rounding of the model."""


@dataclass(frozen=True)
class Fingers:
    """The fingers of an arm.

    Attributes:
        bodies: MuJoCo ids of the bodies that the gripper moves relative to the tool.
        angle: Rad, in (-pi/2, pi/2]: about the tool's z axis, from its x axis to the line along
            which the fingers move; None if they do not move along one line across the z axis.
        reason: Why there is no angle; empty with one.
    """

    bodies: frozenset[int]
    angle: float | None
    reason: str = ""


def read_fingers(arm: Arm) -> Fingers:
    """The fingers of an arm; without any (suction, no gripper) the tool's x axis counts."""
    gripper = arm.gripper
    if gripper is None:
        return Fingers(frozenset(), 0.0)
    model = arm.asset.engine.model
    data = _reference_state(model)
    motion = _opening(model, data, arm)
    bodies = _moved_bodies(model, data, motion, arm.term.solver.chain.body)
    if gripper.finger_axis is not None:
        across, along = gripper.finger_axis[:2]
        return Fingers(bodies, _angle(float(np.arctan2(along, across))))
    if not bodies:
        return Fingers(bodies, 0.0)
    linear, angular = _velocities(model, data, motion, arm.term.solver.chain.body, bodies)
    angle, reason = _line(linear, angular)
    return Fingers(bodies, angle, reason)


def unclear_fingers(
    steps: Sequence[ReadStep], pairs: Sequence[tuple[DeclaredArm, Arm]], fingers: Sequence[Fingers]
) -> list[Problem]:
    """Grippers that steps align although the line along which their fingers move is not clear.

    Args:
        steps: The steps, whose arms exist.
        pairs: The arms.
        fingers: Those of each arm.

    Returns:
        A mistake for each of them.
    """
    declared = [one for one, _ in pairs]
    problems: dict[str, Problem] = {}
    for read in (one for step in steps for one in step.flat() if not one.within):
        for name, lane in (pair for phase in read.phases for pair in phase.items()):
            goals = [one.goal for one in lane if isinstance(one, Move)]
            if not any(goal.align is not None and not goal.held for goal in goals):
                continue
            number = declared.index(find_arm(name, declared, read.path))
            gripper, found = declared[number].gripper, fingers[number]
            if found.angle is None:
                message = (
                    f"needed by {read.path}, which turns the gripper to its target: {found.reason}."
                    " Give x, y or a vector in the tool's frame, or the step align: false"
                )
                path = f"actions.{gripper}.params.finger_axis"
                problems[path] = problems.get(path, Problem(path, message))
    return list(problems.values())


def check_fingers(env: BaseEnv) -> None:
    """Check that the steps in a task's section `expert` turn only grippers that can be turned.

    Raises:
        ConfigError: If it is not clear along which line the fingers of one of them move.
    """
    if not isinstance(env.cfg.expert, list):
        return
    pairs = arms_of(env)
    steps, problems = check_steps(env.cfg.expert, [one for one, _ in pairs])
    if problems:  # said by the policy, if it is used
        return
    unclear = unclear_fingers(steps, pairs, [read_fingers(arm) for _, arm in pairs])
    if unclear:
        raise ConfigError(unclear)


def _reference_state(model: mujoco.MjModel) -> mujoco.MjData:
    """The model at ``qpos0``, where closed loops are closed, without contacts."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_tendon(model, data)
    mujoco.mj_makeM(model, data)
    mujoco.mj_makeConstraint(model, data)
    mujoco.mj_transmission(model, data)
    return data


def _opening(model: mujoco.MjModel, data: mujoco.MjData, arm: Arm) -> F64:
    """(nv,) accelerations while the gripper opens, of any size; the arm's joints are held.

    They minimize Gauss's constraint over the motions that the equalities allow.
    """
    gripper = arm.gripper
    if gripper is None:
        raise ValueError("there is no gripper")
    force = gripper.opening_force(data)
    moves = force != 0.0
    held = np.zeros(model.nv, np.bool_)
    held[np.asarray(arm.asset.entity.dof_adr, np.int64)[arm.term.solver.moving]] = True
    held &= ~moves
    rows = [(columns[~held[columns]], values[~held[columns]]) for columns, values in
            _equalities(model, data)]  # fmt: skip
    while True:  # to what a row couples with what moves, until there is no more
        coupled = [columns for columns, _ in rows if moves[columns].any()]
        more = np.unique(np.concatenate(coupled)) if coupled else np.zeros(0, np.int64)
        if moves[more].all():
            break
        moves[more] = True
    free = np.flatnonzero(moves)
    found = np.zeros(model.nv)
    if not len(free):
        return found
    allowed = _null_space(_dense([one for one in rows if moves[one[0]].any()], free))
    mass = allowed.T @ _inertia(model, data, free) @ allowed
    found[free] = allowed @ np.linalg.solve(mass, allowed.T @ force[free])
    return found


def _equalities(model: mujoco.MjModel, data: mujoco.MjData) -> list[tuple[Ids, F64]]:
    """Columns and values of each row of the Jacobian of the active equality constraints."""
    equal = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    found = []
    for row in equal:
        if mujoco.mj_isSparse(model):
            first = data.efc_J_rowadr[row]
            there = slice(first, first + data.efc_J_rownnz[row])
            columns, values = data.efc_J_colind[there], data.efc_J[there]
        else:
            columns, values = np.arange(model.nv), data.efc_J.reshape(-1, model.nv)[row]
        large = np.abs(values) > _COUPLED
        found.append((columns[large].astype(np.int64), values[large].copy()))
    return found


def _dense(rows: Sequence[tuple[Ids, F64]], columns: Ids) -> F64:
    """(e, k) rows at some columns, sorted, which contain all theirs."""
    found = np.zeros((len(rows), len(columns)))
    for row, (there, values) in zip(found, rows, strict=True):
        row[np.searchsorted(columns, there)] = values
    return found


def _inertia(model: mujoco.MjModel, data: mujoco.MjData, dofs: Ids) -> F64:
    """(k, k) of the mass matrix, without the rest of it, which may be large."""
    found = np.zeros((len(dofs), len(dofs)))
    motion, momentum = np.zeros(model.nv), np.zeros(model.nv)
    for column, dof in enumerate(dofs):
        motion[:] = 0.0
        motion[dof] = 1.0
        mujoco.mj_mulM(model, data, momentum, motion)
        found[:, column] = momentum[dofs]
    return found


def _null_space(rows: F64) -> F64:
    """(k, m) orthonormal columns: the motions of k joints that rows (e, k) allow."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, sizes, vectors = np.linalg.svd(rows)
    rank = int((sizes > _RANK * max(float(sizes.max(initial=0.0)), _COUPLED)).sum())
    found: F64 = vectors[rank:].T
    return found


def _body_motion(
    model: mujoco.MjModel, data: mujoco.MjData, motion: F64, point: F64, body: int
) -> tuple[F64, F64]:
    """Velocity of a point of a body, (3,), and angular velocity, (3,), world axes."""
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, linear, angular, point, body)
    return linear @ motion, angular @ motion


def _relative(
    model: mujoco.MjModel, data: mujoco.MjData, motion: F64, tool: int, point: F64, body: int
) -> tuple[F64, F64]:
    """Velocity of a point of a body and angular velocity, seen from the tool, in its axes."""
    linear, angular = _body_motion(model, data, motion, point, body)
    carried, turn = _body_motion(model, data, motion, data.xpos[tool], tool)
    linear = linear - carried - np.cross(turn, point - data.xpos[tool])
    axes = data.xmat[tool].reshape(3, 3)
    return linear @ axes, (angular - turn) @ axes


def _moved_bodies(
    model: mujoco.MjModel, data: mujoco.MjData, motion: F64, tool: int
) -> frozenset[int]:
    """Bodies whose joints, or those above them, move relative to the tool; not what carries it."""
    driven = np.abs(motion) > 0.0
    if not driven.any():
        return frozenset()
    movers = set(model.dof_bodyid[driven].tolist())
    above_tool = set(_ancestors(model, tool))
    speeds = {}
    for body in range(1, model.nbody):
        if movers & set(_ancestors(model, body)) and body not in above_tool:
            parts = _relative(model, data, motion, tool, data.xipos[body], body)
            speeds[body] = float(np.linalg.norm(np.concatenate(parts)))
    fastest = max(speeds.values(), default=0.0)
    return frozenset(body for body, speed in speeds.items() if speed > _STILL * fastest)


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and those that carry it, without the world."""
    found = []
    while body:
        found.append(body)
        body = int(model.body_parentid[body])
    return found


def _velocities(
    model: mujoco.MjModel, data: mujoco.MjData, motion: F64, tool: int, bodies: frozenset[int]
) -> tuple[F64, F64]:
    """Velocities (g, 3) of the middles of the fingers' shapes and angular velocities, tool axes.

    Shapes that collide count, without any all, without any the centres of mass.
    """
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, sorted(bodies)))
    solid = geoms[(model.geom_contype[geoms] != 0) | (model.geom_conaffinity[geoms] != 0)]
    chosen = solid if len(solid) else geoms
    points = [(data.geom_xpos[geom], int(model.geom_bodyid[geom])) for geom in chosen]
    points = points or [(data.xipos[body], body) for body in sorted(bodies)]
    parts = [_relative(model, data, motion, tool, *one) for one in points]
    return np.stack([linear for linear, _ in parts]), np.stack([angular for _, angular in parts])


def _line(linear: F64, angular: F64) -> tuple[float | None, str]:
    """The angle of the line along which shapes move, or None and why there is none."""
    across = linear[:, :2]
    if (across**2).sum() < _FLAT * (linear**2).sum() or not linear.any():
        # Fingers that hang on hinges move along z where they are spread out: what they turn about
        # and z have the direction in which they close.
        across = np.stack([angular[:, 1], -angular[:, 0]], axis=1)
        if not across.any() or (across**2).sum() < _FLAT * (angular**2).sum():
            return None, "its fingers do not move across the tool's z axis"
    spread = across.T @ across
    sizes = np.linalg.eigvalsh(spread)
    if sizes[0] > _SPREAD * sizes[1]:
        return None, "its fingers do not move along one line"
    twice = float(np.arctan2(2.0 * spread[0, 1], spread[0, 0] - spread[1, 1]))
    return _angle(round(0.5 * twice, _ROUNDED)), ""


def _angle(angle: float) -> float:
    """The angle of a line, in (-pi/2, pi/2]; quarters of a turn are exact."""
    turned = angle - np.pi * np.ceil(angle / np.pi - 0.5)
    quarters = round(turned / (0.5 * np.pi))
    if abs(turned - quarters * 0.5 * np.pi) < 10.0**-_ROUNDED:
        return float(abs(quarters) * 0.5 * np.pi)
    return float(turned)
