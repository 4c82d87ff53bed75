"""`ArmSolver`: forward and inverse kinematics of a robot's tool, in all environments at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.solvers.chain import Chain, Frames, matmul
from embodichain.lab.sim.solvers.least_squares import (
    LeastSquares,
    Target,
    clamped,
    joint_step,
    pose_error,
    squared,
    times,
    transposed,
)
from embodichain.lab.sim.solvers.solution_sets import distinct, ranked
from embodichain.lab.sim.solvers.ur_arm import UrArm
from embodichain.utils.arrays import contiguous
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import (
    matrix_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.cfg import SolverCfg
    from embodichain.lab.sim.engine.api import F64, EnvIndex
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.reads.frames import BodyFrames

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
    model, index = asset.engine.model, asset.index
    movers = {int(model.dof_bodyid[d]) for d in index.dof_adr[list(joints)]}
    found: list[tuple[int, int]] = []
    for body in map(int, index.body_ids):
        above, here, carrier = set(), body, 0
        while here != 0:
            above.add(here)
            if carrier == 0 and model.body_dofnum[here]:
                carrier = here
            here = int(model.body_parentid[here])
        if movers <= above and carrier in movers:
            found.append((len(above), body))
    deepest = max((depth for depth, _ in found), default=0)
    return [body for depth, body in found if depth == deepest]


class Approach(NamedTuple):
    """One step towards a pose.

    Attributes:
        change: (n, k) of the moving joints, rad or m.
        distance: (n,) metres that remain after it, to first order.
        angle: (n,) rad that remain; 0 where the orientation is free.
        stationary: (n,) whether no motion of the joints within their limits reduces the error by a
            notable part, as at the border of the workspace.
    """

    change: F64
    distance: F64
    angle: F64
    stationary: NDArray[np.bool_]


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
            kind, model = self.chain.tool.kind, asset.engine.model
            number = int(self.chain.tool.ids)
            one = {"link": model.body, "site": model.site, "geom": model.geom}[kind](number)
            message = f"none of the picked joints moves {one.name.removeprefix(f'{asset.uid}/')!r}"
            raise ConfigError([Problem(f"{path}.{kind}_names".lstrip("."), message)])
        self.names = tuple(asset.joint_names[joint] for joint in self.moving)
        self._samples = cfg.num_samples
        self._search = LeastSquares(
            self.chain,
            self._columns,
            cfg.pos_eps,
            cfg.rot_eps,
            cfg.max_iterations,
            _posture(cfg, self.names),
        )
        self._weights = np.ones(len(self.moving))
        if cfg.ik_nearest_weight is not None:
            if len(cfg.ik_nearest_weight) != len(self.moving):
                message = f"needs {len(self.moving)} values, one a joint: {', '.join(self.names)}"
                raise ConfigError([Problem("solver_cfg.ik_nearest_weight", message)])
            self._weights = np.asarray(cfg.ik_nearest_weight, np.float64)
        self._closed: UrArm | None = None
        if cfg.closed_form and len(self.moving) == 6:
            arm = UrArm(self.chain)
            self._closed = arm if arm.fits else None

    @property
    def hinges(self) -> NDArray[np.bool_]:
        """(k,) whether each of the joints `moving` is a hinge, not a slide."""
        found: NDArray[np.bool_] = self.chain.hinges[self._columns]
        return found

    @property
    def has_closed_form(self) -> bool:
        """Whether solutions are computed in closed form."""
        return self._closed is not None and self.chain.is_shared

    def frames(self, qpos: F64, env_ids: EnvIndex | None = None) -> Frames:
        """Axes of the chain's joints and pose of the tool at joint positions (n, D)."""
        return self.chain.frames(self._in_chain(qpos), env_ids)

    def forward(self, qpos: F64, env_ids: EnvIndex | None = None) -> tuple[F64, F64]:
        """Position (n, 3) and orientation (n, 4) of the tool at joint positions (n, D)."""
        pos, quat = self.forward_in_root(qpos, env_ids)
        root_pos, root_quat = self.root_pose(env_ids)
        return root_pos + quat_rotate(root_quat, pos), quat_multiply(root_quat, quat)

    def forward_in_root(self, qpos: F64, env_ids: EnvIndex | None = None) -> tuple[F64, F64]:
        """`forward` in the frame of the root."""
        frames = self.frames(qpos, env_ids)
        quat = matrix_to_quat(np.moveaxis(frames.rotation, -1, 0))
        return contiguous(frames.position.T), quat

    def jacobian(self, qpos: F64, env_ids: EnvIndex | None = None) -> F64:
        """(n, 6, k) of the joints `moving`: linear velocity of the tool, then angular velocity."""
        found = self.chain.jacobian(self.frames(qpos, env_ids))
        turn = np.moveaxis(quat_to_matrix(self.root_pose(env_ids)[1]), 0, -1)
        columns = [
            np.concatenate([matmul(turn, found[:3, column]), matmul(turn, found[3:, column])])
            for column in self._columns
        ]
        return contiguous(np.moveaxis(np.stack(columns, axis=1), -1, 0))

    def to_root(self, pos: F64, quat: F64 | None, env_ids: EnvIndex | None = None) -> Target:
        """Poses (n, 3), (n, 4) of the environment's frame in that of the root."""
        root_pos, root_quat = self.root_pose(env_ids)
        back = quat_conjugate(root_quat)
        turned = None if quat is None else quat_multiply(back, quat)
        return Target.of(quat_rotate(back, pos - root_pos), turned)

    def inverse(
        self,
        qpos: F64,
        pos: F64,
        quat: F64 | None,
        env_ids: EnvIndex | None = None,
        *,
        restarts: bool = True,
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Find joint positions that move the tool to poses.

        Args:
            qpos: (n, D) initial positions of all joints.
            pos: (n, 3) target positions.
            quat: (n, 4) target orientations; None leaves them free.
            env_ids: (n,) environments.
            restarts: Whether to search from other points where the initial ones fail.

        Returns:
            (n, D) joint positions within the limits, and (n,) whether they reach the poses. Where
            they do not, they are the nearest that were found; where the initial ones do, these.
        """
        target = self.to_root(pos, quat, env_ids)
        if quat is None or not self.has_closed_form:
            return self._searched(qpos, target, env_ids, self._samples if restarts else 0)
        solutions, exist = self._all(qpos, target, env_ids)
        error = pose_error(self.frames(qpos, env_ids), target)
        there = (squared(error) < _SAME**2) & self._within_limits(qpos, env_ids)
        found = np.where(there[:, None], qpos, solutions[0])
        reached = there | exist[0]
        left = np.flatnonzero(~reached)
        if len(left):
            ids = left if env_ids is None else env_ids[left]
            found[left], reached[left] = self._searched(qpos[left], target.rows(left), ids, 0)
        return found, reached

    def solutions(
        self, qpos: F64, pos: F64, quat: F64, env_ids: EnvIndex | None = None
    ) -> tuple[F64, NDArray[np.bool_]]:
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
            return self._found(qpos, target, env_ids)
        return self._all(qpos, target, env_ids)

    def approach(
        self,
        qpos: F64,
        frames: Frames,
        error: F64,
        largest: F64,
        posture: F64 | None = None,
        gain: float = 0.0,
        env_ids: EnvIndex | None = None,
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
        """
        jacobian = self.chain.jacobian(frames)[: len(error), self._columns]
        now = contiguous(qpos[:, self.moving].T)
        low, high = self.limits(env_ids)
        # Joints beyond a limit come back to it.
        lowest, highest = np.minimum(low - now, 0.0), np.maximum(high - now, 0.0)
        lean = None if posture is None else gain * (posture[:, None] - now)
        step = joint_step(error, jacobian, lowest, highest, lean)
        share = np.abs(step) / largest[:, None]
        step = step / np.maximum(share.max(axis=0), 1.0)
        slope = clamped(transposed(jacobian, error), lowest, highest)
        stationary = np.abs(slope).max(axis=0) < _FLAT * np.sqrt(squared(error))
        left = error - times(jacobian, step)
        distance = np.sqrt(squared(left[:3]))
        angle = np.sqrt(squared(left[3:])) if len(left) > 3 else np.zeros_like(distance)
        return Approach(contiguous(step.T), distance, angle, stationary)

    def limits(self, env_ids: EnvIndex | None = None) -> tuple[F64, F64]:
        """Lowest and highest positions (k, n) of the moving joints."""
        low, high = self._asset.drives.limits.of(self.moving, env_ids)
        return contiguous(low.T), contiguous(high.T)

    def _all(
        self, qpos: F64, target: Target, env_ids: EnvIndex | None
    ) -> tuple[F64, NDArray[np.bool_]]:
        closed, rotation = self._closed, target.rotation
        if closed is None or rotation is None:
            raise ValueError("there is no closed form")
        seed = self._in_chain(qpos)
        limits = self.limits(env_ids)
        found, exist = closed.nearest(seed, target.position, rotation, *limits, self._weights)
        whole = np.tile(qpos, (len(found), 1, 1))
        whole[..., self.moving] = np.moveaxis(found, 1, -1)
        return whole, exist

    def _found(
        self, qpos: F64, target: Target, env_ids: EnvIndex | None
    ) -> tuple[F64, NDArray[np.bool_]]:
        start, (low, high) = self._in_chain(qpos), self.limits(env_ids)
        found, reached = self._search.solve_all(start, target, low, high, self._samples, env_ids)
        seed, positions = start[self._columns], found[:, self._columns]
        near, exist = ranked(positions, reached, seed, (low, high), self._weights, self.hinges)
        near, exist = distinct(near, exist, seed)
        whole = np.tile(qpos, (len(near), 1, 1))
        whole[..., self.moving] = np.moveaxis(near, 1, -1)
        return whole, exist

    def _within_limits(self, qpos: F64, env_ids: EnvIndex | None) -> NDArray[np.bool_]:
        low, high = self.limits(env_ids)
        now = qpos[:, self.moving].T
        beyond = np.maximum(low - now, now - high).max(axis=0)
        within: NDArray[np.bool_] = np.asarray(beyond <= 0.0)
        return within

    def _searched(
        self, qpos: F64, target: Target, env_ids: EnvIndex | None, restarts: int
    ) -> tuple[F64, NDArray[np.bool_]]:
        low, high = self.limits(env_ids)
        start = self._in_chain(qpos)
        found, reached = self._search.solve(start, target, low, high, restarts, env_ids)
        whole = qpos.copy()
        whole[:, self.moving] = found[self._columns].T
        return whole, reached

    def _in_chain(self, qpos: F64) -> F64:
        """(K, n) positions of the chain's joints."""
        return contiguous(qpos[:, self.chain.joints].T)

    def root_pose(self, env_ids: EnvIndex | None = None) -> tuple[F64, F64]:
        """Position (n, 3) and orientation (n, 4) of the root."""
        pos, quat = self._asset.read_pose()
        return (pos, quat) if env_ids is None else (pos[env_ids], quat[env_ids])


def _posture(cfg: SolverCfg, names: Sequence[str]) -> F64 | None:
    """(k,) positions, NaN for joints without a preference; None without any."""
    if not cfg.posture:
        return None
    found = np.full(len(names), np.nan)
    for pattern, position in cfg.posture.items():
        hits, problems = match(pattern, names, "joint of the arm", "solver_cfg.posture")
        if problems:
            raise ConfigError(problems)
        found[hits] = position
    return found
