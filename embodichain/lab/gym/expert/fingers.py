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

from embodichain.lab.gym.expert.arms import ControlledArm, DeclaredArm, arms_of, find_arm
from embodichain.lab.gym.expert.instructions import Facing, Move
from embodichain.lab.gym.expert.program import check_steps
from embodichain.lab.gym.expert.reading import ParsedStep, flat_steps
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.api import F64

    Ids = NDArray[np.int64]
    Mask = NDArray[np.bool_]
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = ["Fingers", "check_fingers", "read_fingers", "unclear_fingers"]

_SPREAD = 0.03
"""Share of the squared speeds that may be across the line: about 10 degrees."""
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
        length: Metres along the tool's z axis, from it to the ends of the fingers; without fingers
            to the end of the tool itself.
    """

    bodies: frozenset[int]
    angle: float | None
    reason: str = ""
    length: float = 0.0


def read_fingers(arm: ControlledArm) -> Fingers:
    """The fingers of an arm; without any (suction, no gripper) the tool's x axis counts."""
    model = arm.asset.engine.model
    data = _reference_state(model)
    if arm.gripper is None:
        body = arm.term.solver.chain.body
        return Fingers(frozenset(), 0.0, length=_length(model, data, frozenset([body]), arm))
    opening = _Opening(
        model=model,
        data=data,
        qvel=_opening_motion(model, data, arm),
        tool=arm.term.solver.chain.body,
    )
    bodies = opening.moved_bodies()
    length = _length(model, data, bodies, arm)
    finger_axis = arm.gripper.finger_axis
    if finger_axis is not None:
        angle = _line_angle(float(np.arctan2(finger_axis[1], finger_axis[0])))
        return Fingers(bodies, angle, length=length)
    if not bodies:
        return Fingers(bodies, 0.0)
    linear, angular = opening.velocities(bodies)
    fitted_angle, reason = _fit_line(linear, angular)
    return Fingers(bodies, fitted_angle, reason, length)


def unclear_fingers(
    steps: Sequence[ParsedStep],
    pairs: Sequence[tuple[DeclaredArm, ControlledArm]],
    fingers: Sequence[Fingers],
) -> list[Problem]:
    """Grippers that steps align although the line along which their fingers move is not clear.

    Args:
        steps: The steps, whose arms exist.
        pairs: The arms.
        fingers: Those of each arm.

    Returns:
        A mistake for each of them.
    """
    declared_arms = [declared for declared, _ in pairs]
    problems: dict[str, Problem] = {}
    for step in flat_steps(steps):
        if step.inner_steps:  # steps inside another are checked by themselves
            continue
        for name in _aligned_arms(step):
            number = declared_arms.index(find_arm(name, declared_arms, step.path))
            if fingers[number].angle is not None:
                continue
            message = (
                f"needed by {step.path}, which turns the gripper to its target: "
                f"{fingers[number].reason}."
                " Give x, y or a vector in the tool's frame, or the step align: false"
            )
            path = f"actions.{declared_arms[number].gripper}.params.finger_axis"
            problems.setdefault(path, Problem(path, message))
    return list(problems.values())


def _aligned_arms(step: ParsedStep) -> list[str]:
    """Return the arms whose fingers a step turns to a target, once for each phase."""
    arms: list[str] = []
    for phase in step.phases:
        for arm, instructions in phase.items():
            goals = [item.goal for item in instructions if isinstance(item, Move)]
            if any(isinstance(goal.turn, Facing) and not goal.held for goal in goals):
                arms.append(arm)
    return arms


def check_fingers(env: BaseEnv) -> None:
    """Check that the steps in a task's section `expert` turn only grippers that can be turned.

    Raises:
        ConfigError: If it is not clear along which line the fingers of one of them move.
    """
    if not isinstance(env.cfg.expert, list):
        return
    pairs = arms_of(env)
    steps, problems = check_steps(env.cfg.expert, [declared for declared, _ in pairs])
    if problems:  # the policy raises them, if it is used
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


@dataclass(frozen=True)
class _Equality:
    """One row of the Jacobian of equality constraints, without its zeros.

    Attributes:
        dofs: (k,) the degrees of freedom that it couples, sorted.
        values: (k,) the entries.
    """

    dofs: Ids
    values: F64

    def without(self, is_held: Mask) -> _Equality:
        """Return the row without degrees of freedom that do not move; (nv,)."""
        is_free = ~is_held[self.dofs]
        return _Equality(self.dofs[is_free], self.values[is_free])


def _opening_motion(model: mujoco.MjModel, data: mujoco.MjData, arm: ControlledArm) -> F64:
    """(nv,) accelerations while the gripper opens, of any size; the arm's joints are held.

    They minimize Gauss's constraint over the motions that the equalities allow.
    """
    if arm.gripper is None:
        raise ValueError("there is no gripper")
    force = arm.gripper.opening_force(data)
    is_moving = force != 0.0
    is_held = np.zeros(model.nv, np.bool_)
    is_held[np.asarray(arm.asset.index.dof_adr, np.int64)[arm.term.solver.moving]] = True
    is_held &= ~is_moving
    equalities = [row.without(is_held) for row in _active_equalities(model, data)]
    while True:  # what moves also moves what it is coupled with, until nothing is added
        coupled = [row.dofs for row in equalities if is_moving[row.dofs].any()]
        if not coupled:
            break
        dofs = np.unique(np.concatenate(coupled))
        if is_moving[dofs].all():
            break
        is_moving[dofs] = True

    acceleration = np.zeros(model.nv)
    moving = np.flatnonzero(is_moving)
    if not len(moving):
        return acceleration
    equalities = [row for row in equalities if is_moving[row.dofs].any()]
    allowed = _null_space(_dense_rows(equalities, moving))
    mass = allowed.T @ _inertia(model, data, moving) @ allowed
    acceleration[moving] = allowed @ np.linalg.solve(mass, allowed.T @ force[moving])
    return acceleration


def _active_equalities(model: mujoco.MjModel, data: mujoco.MjData) -> list[_Equality]:
    """Read the rows of the equality constraints that are active."""
    rows: list[_Equality] = []
    for row in np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY):
        if mujoco.mj_isSparse(model):
            first = data.efc_J_rowadr[row]
            entries = slice(first, first + data.efc_J_rownnz[row])
            dofs = data.efc_J_colind[entries]
            values = data.efc_J[entries]
        else:
            dofs = np.arange(model.nv)
            values = data.efc_J.reshape(-1, model.nv)[row]
        is_coupled = np.abs(values) > _COUPLED
        rows.append(_Equality(dofs[is_coupled].astype(np.int64), values[is_coupled].copy()))
    return rows


def _dense_rows(rows: Sequence[_Equality], dofs: Ids) -> F64:
    """(e, k) rows at k degrees of freedom, sorted, which contain all that the rows couple."""
    matrix = np.zeros((len(rows), len(dofs)))
    for number, row in enumerate(rows):
        matrix[number, np.searchsorted(dofs, row.dofs)] = row.values
    return matrix


def _inertia(model: mujoco.MjModel, data: mujoco.MjData, dofs: Ids) -> F64:
    """(k, k) of the mass matrix, without the rest of it, which may be large."""
    inertia = np.zeros((len(dofs), len(dofs)))
    unit = np.zeros(model.nv)
    momentum = np.zeros(model.nv)
    for column, dof in enumerate(dofs):
        unit[:] = 0.0
        unit[dof] = 1.0
        mujoco.mj_mulM(model, data, momentum, unit)
        inertia[:, column] = momentum[dofs]
    return inertia


def _null_space(rows: F64) -> F64:
    """(k, m) orthonormal columns: the motions of k joints that rows (e, k) allow."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, sizes, vectors = np.linalg.svd(rows)
    rank = int((sizes > _RANK * max(float(sizes.max(initial=0.0)), _COUPLED)).sum())
    return vectors[rank:].T


@dataclass(frozen=True)
class _Opening:
    """A gripper that opens: its model, and how fast everything in it moves.

    Attributes:
        model: The model.
        data: Its state.
        qvel: (nv,) velocities, of any size.
        tool: The body of the tool.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    qvel: F64
    tool: int

    def moved_bodies(self) -> frozenset[int]:
        """Bodies that their joints, or those above, move relative to the tool; not its carriers."""
        is_driven = np.abs(self.qvel) > 0.0
        if not is_driven.any():
            return frozenset()
        driven_bodies = set(self.model.dof_bodyid[is_driven].tolist())
        above_tool = set(_ancestors(self.model, self.tool))
        speeds: dict[int, float] = {}
        for body in range(1, self.model.nbody):
            is_carried = not driven_bodies.isdisjoint(_ancestors(self.model, body))
            if is_carried and body not in above_tool:
                twist = np.concatenate(self._relative_velocity(self.data.xipos[body], body))
                speeds[body] = float(np.linalg.norm(twist))
        fastest = max(speeds.values(), default=0.0)
        return frozenset(body for body, speed in speeds.items() if speed > _STILL * fastest)

    def velocities(self, bodies: frozenset[int]) -> tuple[F64, F64]:
        """Velocities (g, 3) of the middles of the shapes of bodies, and angular ones, tool axes.

        Shapes that collide count; if there are none, all shapes; if there are none, the bodies'
        centres of mass.
        """
        model = self.model
        geoms = np.flatnonzero(np.isin(model.geom_bodyid, sorted(bodies)))
        is_solid = (model.geom_contype[geoms] != 0) | (model.geom_conaffinity[geoms] != 0)
        if is_solid.any():
            geoms = geoms[is_solid]
        points = [(self.data.geom_xpos[geom], int(model.geom_bodyid[geom])) for geom in geoms]
        if not points:
            points = [(self.data.xipos[body], body) for body in sorted(bodies)]
        velocities = [self._relative_velocity(point, body) for point, body in points]
        linear = np.stack([velocity for velocity, _ in velocities])
        angular = np.stack([velocity for _, velocity in velocities])
        return linear, angular

    def _relative_velocity(self, point: F64, body: int) -> tuple[F64, F64]:
        """Velocity of a point of a body and angular velocity, seen from the tool, in its axes."""
        origin = self.data.xpos[self.tool]
        linear, angular = self._velocity(point, body)
        tool_linear, tool_angular = self._velocity(origin, self.tool)
        linear = linear - tool_linear - np.cross(tool_angular, point - origin)
        axes = self.data.xmat[self.tool].reshape(3, 3)
        return linear @ axes, (angular - tool_angular) @ axes

    def _velocity(self, point: F64, body: int) -> tuple[F64, F64]:
        """Velocity of a point of a body, (3,), and angular velocity, (3,), world axes."""
        linear = np.zeros((3, self.model.nv))
        angular = np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, linear, angular, point, body)
        return linear @ self.qvel, angular @ self.qvel


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and those that carry it, without the world."""
    bodies: list[int] = []
    while body:
        bodies.append(body)
        body = int(model.body_parentid[body])
    return bodies


def _length(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: frozenset[int], arm: ControlledArm
) -> float:
    """How far solid shapes of bodies reach beyond a tool, along its z axis, m; 0 at least."""
    tool = _tool_frame(data, arm)
    ends = [0.0]
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, sorted(bodies))):
        if model.geom_contype[geom] or model.geom_conaffinity[geom]:
            middle = float((data.geom_xpos[geom] - tool.pos) @ tool.axis)
            ends.append(middle + _extent(model, int(geom), data.geom_xmat[geom], tool.axis))
    return round(max(ends), _ROUNDED)


@dataclass(frozen=True)
class _ToolAxis:
    """The origin of a tool, (3,), and its z axis, (3,), in the world."""

    pos: F64
    axis: F64


def _tool_frame(data: mujoco.MjData, arm: ControlledArm) -> _ToolAxis:
    """Where a tool is in a state; a link, site or geom."""
    tool = arm.term.solver.chain.tool
    number = int(tool.ids)
    if tool.kind == "site":
        return _ToolAxis(data.site_xpos[number], data.site_xmat[number].reshape(3, 3)[:, 2])
    if tool.kind == "geom":
        return _ToolAxis(data.geom_xpos[number], data.geom_xmat[number].reshape(3, 3)[:, 2])
    return _ToolAxis(data.xpos[number], data.xmat[number].reshape(3, 3)[:, 2])


def _extent(model: mujoco.MjModel, geom: int, axes: F64, direction: F64) -> float:
    """How far a shape reaches from its frame's origin in a direction (3,), m."""
    local = axes.reshape(3, 3).T @ direction
    size = model.geom_size[geom]
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        return float((vertices @ local).max())
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return float(np.abs(local) @ size)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return float(size[0] + size[1] * abs(local[2]))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return float(size[0] * np.hypot(local[0], local[1]) + size[1] * abs(local[2]))
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return float(np.linalg.norm(local * size))
    return float(size[0])  # a sphere


def _fit_line(linear: F64, angular: F64) -> tuple[float | None, str]:
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
    return _line_angle(round(0.5 * twice, _ROUNDED)), ""


def _line_angle(angle: float) -> float:
    """The angle of a line, in (-pi/2, pi/2]; quarters of a turn are exact."""
    turned = angle - np.pi * np.ceil(angle / np.pi - 0.5)
    quarters = round(turned / (0.5 * np.pi))
    if abs(turned - quarters * 0.5 * np.pi) < 10.0**-_ROUNDED:
        return float(abs(quarters) * 0.5 * np.pi)
    return float(turned)
