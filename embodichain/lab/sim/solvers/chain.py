"""`Chain`: forward kinematics and Jacobian of the joints between a root and a tool.

Arrays here have the environments in the last axis, so that every operation runs along contiguous
rows. All arithmetic is elementwise in a fixed order: a result does not depend on the number of
environments.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import lazy_loader
import numpy as np

from embodichain.lab.sim.reads.frames import link_frame
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_to_matrix

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.api import F64, Engine, EnvIndex
    from embodichain.lab.sim.reads.frames import BodyFrames
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = ["Chain", "Frames", "matmul"]

_FIELDS = ("body_pos", "body_quat", "jnt_pos", "jnt_axis", "qpos0")
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
"""Components of the factors of a cross product."""


class Frames(NamedTuple):
    """Axes of K joints and the pose of the tool in n environments, in the frame of the root.

    Attributes:
        rotation: (3, 3, n) orientation of the tool.
        position: (3, n) of the tool, metres.
        axes: (K, 3, n) unit axes of the joints.
        anchors: (K, 3, n) points on the axes, metres.
    """

    rotation: F64
    position: F64
    axes: F64
    anchors: F64


def matmul(a: F64, b: F64) -> F64:
    """Products of matrices (3, 3, n) and matrices (3, m, n) or vectors (3, n), row by row."""
    parts = a * b if b.ndim == 2 else a[:, :, None] * b
    return parts[:, 0] + parts[:, 1] + parts[:, 2]


class Chain:
    """The hinges and slides between the root of an articulation and a link, site or geom of it.

    The pose of the tool is F[0] Z(q[0]) F[1] Z(q[1]) ... F[K], with Z a rotation about z (hinge) or
    a translation along it (slide), and constant transforms F, which come from the model's
    ``body_pos``, ``body_quat``, ``jnt_pos``, ``jnt_axis`` and ``qpos0``, and those of the site or
    geom. Where these differ between environments, so do the transforms.

    Args:
        engine: The engine.
        index: The articulation.
        tool: The frame of the tool; a number is MuJoCo's id of a body.

    Attributes:
        tool: The frame of the tool.
        body: MuJoCo's id of the body that carries it.
        joints: (K,) indices of the joints in the articulation, from the root to the tool.
        hinges: (K,) whether a joint is a hinge, not a slide.

    Raises:
        ConfigError: If a ball joint is between root and tool.
    """

    def __init__(self, engine: Engine, index: EntityIndex, tool: BodyFrames | int) -> None:
        self.tool = link_frame(tool) if isinstance(tool, int) else tool
        self.body = body = int(self.tool.bodies)
        kind = self.tool.kind
        self._fields = (*_FIELDS, *((f"{kind}_pos", f"{kind}_quat") if kind != "link" else ()))
        self._engine, model = engine, engine.model
        self._bodies: list[int] = []
        while body != index.root_body_id:
            self._bodies.insert(0, body)
            body = int(model.body_parentid[body])
        column = {int(dof): joint for joint, dof in enumerate(index.dof_adr)}
        self._joints = [j for b in self._bodies for j in _joints_of(model, b)]
        kinds = model.jnt_type[self._joints]
        simple = (kinds == mujoco.mjtJoint.mjJNT_HINGE) | (kinds == mujoco.mjtJoint.mjJNT_SLIDE)
        if not simple.all():
            name = model.joint(self._joints[int(np.argmin(simple))]).name
            message = f"{name!r} between the root and the tool is a ball joint"
            raise ConfigError([Problem("link_names", message)])
        dofs = model.jnt_dofadr[self._joints]
        self.joints: NDArray[np.int64] = np.array([column[int(d)] for d in dofs], np.int64)
        self.hinges: NDArray[np.bool_] = kinds == mujoco.mjtJoint.mjJNT_HINGE
        self._slides = np.flatnonzero(~self.hinges)
        self._qpos_adr = model.jnt_qposadr[self._joints]
        self._shared: tuple[F64, F64] | None = None

    @property
    def is_shared(self) -> bool:
        """Whether all environments have the same transforms."""
        return all(len(self._engine.model_values(name)) == 1 for name in self._fields)

    @property
    def reach(self) -> float:
        """Metres: the length of all links, an upper bound of the tool's distance without slides."""
        shifts = self._transforms(None)[0][:, :, 3]
        return float(np.linalg.norm(shifts, axis=1).max(axis=1).sum())

    def frames(self, qpos: F64, env_ids: EnvIndex | None = None) -> Frames:
        """Compute the frames at joint positions.

        Args:
            qpos: (K, n) contiguous positions of the chain's joints, rad or m.
            env_ids: (n,) environments, or None for all; needed where model fields differ.
        """
        transforms, zero = self._transforms(env_ids)
        moved = qpos - zero
        turned = np.where(self.hinges[:, None], moved, 0.0) if len(self._slides) else moved
        cosines, sines = np.cos(turned)[:, None], np.sin(turned)[:, None]
        count, size = moved.shape
        # Z(q[j]) F[j + 1] of every joint, then their products.
        moves = np.empty_like(moved, shape=(count, 3, 4, size))
        x, y = transforms[1:, 0], transforms[1:, 1]
        moves[:, 0] = x * cosines - y * sines
        moves[:, 1] = x * sines + y * cosines
        moves[:, 2] = transforms[1:, 2]
        for slide in self._slides:
            moves[slide, 2, 3] += moved[slide]
        poses = np.empty_like(moved, shape=(count + 1, 3, 4, size))
        poses[0] = transforms[0]
        for pose, move, product in zip(poses, moves, poses[1:], strict=False):
            product[:] = matmul(pose[:, :3], move)
            product[:, 3] += pose[:, 3]
        return Frames(poses[-1, :, :3], poses[-1, :, 3], poses[:-1, :, 2], poses[:-1, :, 3])

    def jacobian(self, frames: Frames) -> F64:
        """(6, K, n) velocity of the tool's origin, then angular velocity, per joint velocity."""
        axes, anchors = np.swapaxes(frames.axes, 0, 1), np.swapaxes(frames.anchors, 0, 1)
        arm = frames.position[:, None] - anchors
        found = np.empty_like(frames.position, shape=(6, *axes.shape[1:]))
        found[:3] = axes.take(_NEXT, 0) * arm.take(_LAST, 0)
        found[:3] -= axes.take(_LAST, 0) * arm.take(_NEXT, 0)
        found[3:] = axes
        for slide in self._slides:
            found[:3, slide], found[3:, slide] = axes[:, slide], 0.0
        return found

    def _transforms(self, env_ids: EnvIndex | None) -> tuple[F64, F64]:
        """Constant transforms (K + 1, 3, 4, n or 1) and zero positions (K, n or 1)."""
        fields = [self._engine.model_values(name) for name in self._fields]
        if all(len(values) == 1 for values in fields):
            if self._shared is None:
                self._shared = self._compute(fields)
            return self._shared
        chosen = [v if len(v) == 1 or env_ids is None else v[env_ids] for v in fields]
        return self._compute(chosen)

    def _compute(self, fields: Sequence[F64]) -> tuple[F64, F64]:
        body_pos, body_quat, jnt_pos, jnt_axis, qpos0, *own = fields
        model = self._engine.model
        rows = max(len(values) for values in fields)
        turn, shift = np.tile(np.eye(3)[..., None], rows), np.zeros((3, rows))
        found: list[F64] = []
        for body in self._bodies:
            shift = shift + matmul(turn, body_pos[:, body].T)
            turn = matmul(turn, np.moveaxis(quat_to_matrix(body_quat[:, body]), 0, -1))
            for joint in _joints_of(model, body):
                to_axis = _from_z(jnt_axis[:, joint])
                back = np.swapaxes(to_axis, 0, 1)
                hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
                anchor = jnt_pos[:, joint].T if hinge else np.zeros((3, 1))
                found.append(_pose(matmul(turn, to_axis), shift + matmul(turn, anchor), rows))
                turn, shift = back, matmul(back, -anchor)
        if own:
            pos, quat = (values[:, self.tool.ids] for values in own)
            shift = shift + matmul(turn, pos.T)
            turn = matmul(turn, np.moveaxis(quat_to_matrix(quat), 0, -1))
        found.append(_pose(turn, shift, rows))
        return np.stack(found), qpos0[:, self._qpos_adr].T


def _pose(rotation: F64, position: F64, rows: int) -> F64:
    """(3, 4, rows) of a rotation (3, 3, rows or 1) and a position (3, rows or 1)."""
    found = np.empty((3, 4, rows))
    found[:, :3], found[:, 3] = rotation, position
    return found


def _joints_of(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _from_z(axis: F64) -> F64:
    """(3, 3, n) rotations that turn z to unit vectors (n, 3), by the shorter way."""
    x, y, z = axis.T
    up = z > -1.0 + 1e-12
    half = np.stack([np.where(up, 1.0 + z, 0.0), np.where(up, -y, 1.0), np.where(up, x, 0.0)])
    half = half / np.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
    quat = np.concatenate([half, np.zeros((1, len(axis)))]).T
    return np.moveaxis(quat_to_matrix(quat), 0, -1)
