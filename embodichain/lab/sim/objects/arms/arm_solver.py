"""`ArmSolver`: forward and inverse kinematics of a robot's tool, in all environments at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.solvers.chain import Chain, Frames, matmul
from embodichain.lab.sim.solvers.least_squares import (
    IkTargets,
    LeastSquares,
    clamped,
    joint_step,
    pose_error,
    squared,
    times,
    transposed,
)
from embodichain.lab.sim.solvers.solution_sets import distinct, ranked
from embodichain.lab.sim.solvers.ur_arm import UrArm
from embodichain.utils.arrays import contiguous, may_be_set
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import (
    matrix_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
)

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.lab.sim.cfg import SolverCfg
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.reads.frames import BodyFrames
    from embodichain.utils.array_types import Floats

__all__ = ["Approach", "ArmSolver", "tool_bodies"]

_SAME = 1e-9
"""Errors in metres and rad below which initial positions are a solution, to the bit."""
_FLAT = 0.02
"""Gradient of half the squared error over the error, in m or rad, below which it is stationary."""


def tool_bodies(asset: Articulation, joints: Sequence[int]) -> list[int]:
    """MuJoCo ids of the bodies that all the given joints move, the farthest from the root only.

    Bodies beyond another joint are left out: a hand fixed to an arm's last link counts, its fingers
    do not.
    """
    model = asset.engine.model
    index = asset.index
    moved_by_joints = {int(model.dof_bodyid[dof]) for dof in index.dof_adr[list(joints)]}
    depths: dict[int, int] = {}
    for body in index.body_ids.tolist():
        ancestors = _ancestors(model, body)
        with_joint = [ancestor for ancestor in ancestors if model.body_dofnum[ancestor]]
        is_moved_by_all = moved_by_joints <= set(ancestors)
        if is_moved_by_all and with_joint and with_joint[0] in moved_by_joints:
            depths[body] = len(ancestors)
    deepest = max(depths.values(), default=0)
    return [body for body, depth in depths.items() if depth == deepest]


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Return a body and those above it, up to the world, which is not among them."""
    ancestors = []
    while body != 0:
        ancestors.append(body)
        body = int(model.body_parentid[body])
    return ancestors


class Approach(NamedTuple):
    """One step towards a pose.

    Attributes:
        change: (n, k) of the moving joints, rad or m.
        distance: (n,) metres that remain after it, to first order.
        angle: (n,) rad that remain; 0 where the orientation is free.
        is_out_of_reach: (n,) whether more than the tolerances remains, and no motion of the joints
            within their limits reduces it by a notable part, as at the border of the workspace.
    """

    change: Floats
    distance: Floats
    angle: Floats
    is_out_of_reach: NDArray[np.bool_]


class ArmSolver:
    """Kinematics of one tool of an articulation, moved by some of its joints.

    Joints between root and tool that are not among these keep the positions that they are given.
    The simulation is only read: the pose of the root and, where they differ between environments,
    the fields of the model. Poses are in the environment's frame, quaternions wxyz. n rows belong
    to environments ``env_ids``, (n,), which may repeat; None is all N, once each. A row's result
    depends neither on n nor on the other rows.

    Args:
        asset: The articulation.
        joints: Joints that inverse kinematics may move.
        tool: The frame of the tool; a number is MuJoCo's id of a body.
        cfg: Settings of the search.
        path: Key path of the robot, for messages.

    Attributes:
        chain: The joints between root and tool.
        moving: (k,) indices in the articulation of those that may move, from root to tool.

    Raises:
        ConfigError: If none of the joints moves the tool, or a ball joint is in the chain.
    """

    def __init__(
        self,
        asset: Articulation,
        joints: Sequence[int],
        tool: BodyFrames | int,
        cfg: SolverCfg,
        path: str = "",
    ) -> None:
        self._asset = asset
        self.chain = Chain(asset.engine, asset.index, tool)
        self._columns = np.flatnonzero(np.isin(self.chain.joints, list(joints)))
        self.moving = self.chain.joints[self._columns]
        if not len(self.moving):
            tool = self.chain.tool
            tool_name = _frame_name(asset, tool)
            message = f"none of the picked joints moves {tool_name!r}"
            raise ConfigError([Problem(f"{path}.{tool.kind}_names".lstrip("."), message)])
        self.names = tuple(asset.joint_names[joint] for joint in self.moving)
        posture = _read_posture(cfg, self.names)
        self._weights = _read_weights(cfg, self.names)

        # Two ways to solve: a search for every arm, and a closed form for some.
        self._samples = cfg.num_samples
        self._least_squares = LeastSquares(
            self.chain,
            self._columns,
            position_tolerance=cfg.pos_eps,
            rotation_tolerance=cfg.rot_eps,
            max_iterations=cfg.max_iterations,
            posture=posture,
        )
        self._closed_form: UrArm | None = None
        if cfg.closed_form and len(self.moving) == 6:
            arm = UrArm(self.chain)
            if arm.fits:
                self._closed_form = arm

    @property
    def hinges(self) -> NDArray[np.bool_]:
        """(k,) whether each of the joints `moving` is a hinge, not a slide."""
        return self.chain.hinges[self._columns]

    @property
    def has_closed_form(self) -> bool:
        """Whether solutions are computed in closed form."""
        return self._closed_form is not None and self.chain.is_shared

    def frames(self, qpos: Floats, env_ids: EnvIndex | None = None) -> Frames:
        """Axes of the chain's joints and pose of the tool at joint positions (n, D)."""
        return self.chain.frames(self._in_chain(qpos), env_ids)

    def forward(self, qpos: Floats, env_ids: EnvIndex | None = None) -> tuple[Floats, Floats]:
        """Position (n, 3) and orientation (n, 4) of the tool at joint positions (n, D)."""
        pos, quat = self.forward_in_root(qpos, env_ids)
        root_pos, root_quat = self.root_pose(env_ids)
        return root_pos + quat_rotate(root_quat, pos), quat_multiply(root_quat, quat)

    def forward_in_root(
        self, qpos: Floats, env_ids: EnvIndex | None = None
    ) -> tuple[Floats, Floats]:
        """`forward` in the frame of the root."""
        frames = self.frames(qpos, env_ids)
        quat = matrix_to_quat(np.moveaxis(frames.rotation, -1, 0))
        return contiguous(frames.position.T), quat

    def jacobian(self, qpos: Floats, env_ids: EnvIndex | None = None) -> Floats:
        """(n, 6, k) of the joints `moving`: linear velocity of the tool, then angular velocity."""
        in_root = self.chain.jacobian(self.frames(qpos, env_ids))
        _, root_quat = self.root_pose(env_ids)
        turn = np.moveaxis(quat_to_matrix(root_quat), 0, -1)
        columns = []
        for column in self._columns:
            linear = matmul(turn, in_root[:3, column])
            angular = matmul(turn, in_root[3:, column])
            columns.append(np.concatenate([linear, angular]))
        return contiguous(np.moveaxis(np.stack(columns, axis=1), -1, 0))

    def to_root(
        self, pos: Floats, quat: Floats | None, env_ids: EnvIndex | None = None
    ) -> IkTargets:
        """Poses (n, 3), (n, 4) of the environment's frame in that of the root."""
        root_pos, root_quat = self.root_pose(env_ids)
        back = quat_conjugate(root_quat)
        turned = None if quat is None else quat_multiply(back, quat)
        return IkTargets.of(quat_rotate(back, pos - root_pos), turned)

    def inverse(
        self,
        qpos: Floats,
        pos: Floats,
        quat: Floats | None,
        env_ids: EnvIndex | None = None,
        *,
        restarts: bool = True,
        low: Floats | None = None,
        high: Floats | None = None,
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Find joint positions that move the tool to poses.

        Args:
            qpos: (n, D) initial positions of all joints.
            pos: (n, 3) target positions.
            quat: (n, 4) target orientations; None leaves them free.
            env_ids: (n,) environments.
            restarts: Whether to search from other points where the initial ones fail.
            low: (k,) lowest positions of the joints `moving`, where the limits are lower.
            high: (k,) highest, where the limits are higher.

        Returns:
            (n, D) joint positions within the limits, and (n,) whether they reach the poses. Where
            they do not, they are the nearest that were found; where the initial ones do, these.
        """
        target = self.to_root(pos, quat, env_ids)
        limits = self._narrowed_limits(env_ids, low, high)
        if quat is None or not self.has_closed_form:
            searches = self._samples if restarts else 0
            return self._search(qpos, target, env_ids, searches, limits)
        solutions, exist = self._solve_closed_form(qpos, target, env_ids, limits)
        error = pose_error(self.frames(qpos, env_ids), target)
        is_solved = (squared(error) < _SAME**2) & self._within_limits(qpos, limits)
        nearest = np.where(is_solved[:, None], qpos, solutions[0])
        reached = is_solved | exist[0]
        # Where there is no solution, a search comes as near as it can.
        unsolved = np.flatnonzero(~reached)
        if len(unsolved):
            ids = unsolved if env_ids is None else env_ids[unsolved]
            low_there, high_there = limits
            solutions, is_reached = self._search(
                qpos[unsolved],
                target.pick(unsolved),
                ids,
                restarts=0,
                limits=(low_there[:, unsolved], high_there[:, unsolved]),
            )
            nearest[unsolved] = solutions
            reached[unsolved] = is_reached
        return nearest, reached

    def solutions(
        self, qpos: Floats, pos: Floats, quat: Floats, env_ids: EnvIndex | None = None
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """All solutions of the closed form, else all that searches find; the nearest first.

        Searches begin at ``qpos`` and at `num_samples` other points between the limits, the same
        ones as those of `inverse`. Solutions in which no joint differs by more than 0.01 rad or m
        count once. An arm with joints to spare has infinitely many, of which this is a sample.

        Returns:
            (S, n, D) joint positions, and (S, n) whether they exist; S = 8, without a closed form
            1 + `num_samples`. Those that do not exist are ``qpos``.
        """
        target = self.to_root(pos, quat, env_ids)
        if not self.has_closed_form:
            return self._search_all(qpos, target, env_ids)
        return self._solve_closed_form(qpos, target, env_ids, self.limits(env_ids))

    def approach(
        self,
        qpos: Floats,
        frames: Frames,
        error: Floats,
        largest: Floats,
        posture: Floats | None = None,
        gain: float = 0.0,
        env_ids: EnvIndex | None = None,
        *,
        position_tolerance: float = np.inf,
        rotation_tolerance: float = np.inf,
    ) -> Approach:
        """One step of damped least squares: differential inverse kinematics.

        Args:
            qpos: (n, D) positions of all joints.
            frames: `frames` of these.
            error: (6, n) wanted motion of the tool in the root's axes, metres and a rotation vector
                in rad, as of `pose_error`; (3, n) leaves the orientation free.
            largest: (k,) largest changes of the moving joints. A step that exceeds them is scaled
                as a whole, so that the tool keeps its direction.
            posture: (k,) positions that the joints approach in the null space, or None.
            gain: The part of the way to them.
            env_ids: (n,) environments.
            position_tolerance: Metres that may remain; infinite if nobody asks for what is out of
                reach.
            rotation_tolerance: Rad that may remain, likewise.
        """
        jacobian = self.chain.jacobian(frames)[: len(error), self._columns]
        moving_qpos = contiguous(qpos[:, self.moving].T)
        low, high = self.limits(env_ids)
        # Joints beyond a limit stay where they are, or come back.
        lowest = np.minimum(low - moving_qpos, 0.0)
        highest = np.maximum(high - moving_qpos, 0.0)
        lean = None if posture is None else gain * (posture[:, None] - moving_qpos)
        step = joint_step(error, jacobian, lowest, highest, posture=lean)
        excess = np.abs(step) / largest[:, None]
        step = step / np.maximum(excess.max(axis=0), 1.0)
        remaining = error - times(jacobian, step)
        distance = np.sqrt(squared(remaining[:3]))
        has_angle = len(remaining) > 3
        angle = np.sqrt(squared(remaining[3:])) if has_angle else np.zeros_like(distance)
        is_far = (distance > position_tolerance) | (angle > rotation_tolerance)
        is_out_of_reach = is_far
        if may_be_set(is_far):  # seldom
            gradient = clamped(transposed(jacobian, error), lowest, highest)
            is_flat = np.abs(gradient).max(axis=0) < _FLAT * np.sqrt(squared(error))
            is_out_of_reach = is_far & is_flat
        return Approach(contiguous(step.T), distance, angle, is_out_of_reach)

    def limits(self, env_ids: EnvIndex | None = None) -> tuple[Floats, Floats]:
        """Lowest and highest positions (k, n) of the moving joints."""
        low, high = self._asset.drives.limits.of(self.moving, env_ids)
        return contiguous(low.T), contiguous(high.T)

    def _narrowed_limits(
        self, env_ids: EnvIndex | None, low: Floats | None, high: Floats | None
    ) -> tuple[Floats, Floats]:
        """`limits` where they are narrower than (k,) others."""
        lowest, highest = self.limits(env_ids)
        if low is not None:
            lowest = np.maximum(lowest, low[:, None])
        if high is not None:
            highest = np.minimum(highest, high[:, None])
        return lowest, highest

    def _solve_closed_form(
        self,
        qpos: Floats,
        target: IkTargets,
        env_ids: EnvIndex | None,
        limits: tuple[Floats, Floats],
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """(8, n, D) solutions of the closed form, the nearest first; (8, n) whether they exist."""
        if self._closed_form is None or target.rotation is None:
            raise ValueError("there is no closed form")
        low, high = limits
        solutions, exist = self._closed_form.nearest(
            seed=self._in_chain(qpos),
            position=target.position,
            rotation=target.rotation,
            low=low,
            high=high,
            weights=self._weights,
        )
        return self._with_other_joints(qpos, solutions), exist

    def _search_all(
        self, qpos: Floats, target: IkTargets, env_ids: EnvIndex | None
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """(S, n, D) solutions of all searches, the nearest first; (S, n) whether they exist."""
        low, high = self.limits(env_ids)
        start = self._in_chain(qpos)
        solutions, reached = self._least_squares.solve_all(
            start, target, low, high, restarts=self._samples, env_ids=env_ids
        )
        seed = start[self._columns]
        solutions, exist = ranked(
            solutions[:, self._columns],
            reached,
            seed,
            limits=(low, high),
            weights=self._weights,
            hinges=self.hinges,
        )
        solutions, exist = distinct(solutions, exist, seed)
        return self._with_other_joints(qpos, solutions), exist

    def _with_other_joints(self, qpos: Floats, solutions: Floats) -> Floats:
        """(S, n, D) positions of all joints, of (S, k, n) positions of the moving ones."""
        all_joints = np.tile(qpos, (len(solutions), 1, 1))
        all_joints[..., self.moving] = np.moveaxis(solutions, 1, -1)
        return all_joints

    def _within_limits(self, qpos: Floats, limits: tuple[Floats, Floats]) -> NDArray[np.bool_]:
        """(n,) whether the moving joints are within limits (k, n)."""
        low, high = limits
        moving_qpos = qpos[:, self.moving].T
        excess = np.maximum(low - moving_qpos, moving_qpos - high).max(axis=0)
        return np.asarray(excess <= 0.0)

    def _search(
        self,
        qpos: Floats,
        target: IkTargets,
        env_ids: EnvIndex | None,
        restarts: int,
        limits: tuple[Floats, Floats],
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """(n, D) joint positions of the best search, and (n,) whether it reaches the target."""
        low, high = limits
        start = self._in_chain(qpos)
        solution, reached = self._least_squares.solve(
            start, target, low, high, restarts=restarts, env_ids=env_ids
        )
        all_joints = qpos.copy()
        all_joints[:, self.moving] = solution[self._columns].T
        return all_joints, reached

    def _in_chain(self, qpos: Floats) -> Floats:
        """(K, n) positions of the chain's joints."""
        return contiguous(qpos[:, self.chain.joints].T)

    def root_pose(self, env_ids: EnvIndex | None = None) -> tuple[Floats, Floats]:
        """Position (n, 3) and orientation (n, 4) of the root."""
        pos, quat = self._asset.read_pose()
        if env_ids is None:
            return pos, quat
        return pos[env_ids], quat[env_ids]


def _frame_name(asset: Articulation, frame: BodyFrames) -> str:
    """The name of a link, site or geom, as in the articulation's file."""
    model = asset.engine.model
    named_by_kind = {"link": model.body, "site": model.site, "geom": model.geom}
    name: str = named_by_kind[frame.kind](int(frame.ids)).name
    return name.removeprefix(f"{asset.uid}/")


def _read_weights(cfg: SolverCfg, names: Sequence[str]) -> Floats:
    """(k,) weights of the joints' squared distances."""
    if cfg.ik_nearest_weight is None:
        return np.ones(len(names))
    if len(cfg.ik_nearest_weight) != len(names):
        message = f"needs {len(names)} values, one a joint: {', '.join(names)}"
        raise ConfigError([Problem("solver_cfg.ik_nearest_weight", message)])
    return np.asarray(cfg.ik_nearest_weight, np.float64)


def _read_posture(cfg: SolverCfg, names: Sequence[str]) -> Floats | None:
    """(k,) positions, NaN for joints without a preference; None without any."""
    if not cfg.posture:
        return None
    posture = np.full(len(names), np.nan)
    for pattern, position in cfg.posture.items():
        matching_joints, problems = match(
            pattern, names, "joint of the arm", path="solver_cfg.posture"
        )
        if problems:
            raise ConfigError(problems)
        posture[matching_joints] = position
    return posture
