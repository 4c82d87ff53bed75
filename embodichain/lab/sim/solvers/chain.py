"""`Chain`: forward kinematics and Jacobian of the joints between a root and a tool.

Arrays here have the environments in the last axis, so that every operation runs along contiguous
rows. All arithmetic is elementwise in a fixed order: a result does not depend on the number of
environments.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_to_matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.api import F64, Engine, EnvIndex

__all__ = ["Chain", "Frames", "matmul"]

_FIELDS = ("body_pos", "body_quat", "jnt_pos", "jnt_axis", "qpos0")


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
    """Products of matrices (3, 3, n), or of matrices and vectors (3, n), row by row."""
    columns = a if b.ndim == 2 else a[:, :, None]
    found: F64 = columns[:, 0] * b[0] + columns[:, 1] * b[1] + columns[:, 2] * b[2]
    return found


class Chain:
    """The hinges and slides between the root of an articulation and one of its bodies.

    The pose of the tool is F[0] Z(q[0]) F[1] Z(q[1]) ... F[K], with Z a rotation about z (hinge) or
    a translation along it (slide), and constant transforms F, which come from the model's
    ``body_pos``, ``body_quat``, ``jnt_pos``, ``jnt_axis`` and ``qpos0``. Where these differ between
    environments, so do the transforms.

    Args:
        engine: The engine.
        index: The articulation.
        body: MuJoCo body id of the tool.

    Attributes:
        body: The tool.
        joints: (K,) indices of the joints in the articulation, from the root to the tool.
        hinges: (K,) whether a joint is a hinge, not a slide.

    Raises:
        ConfigError: If a ball joint is between root and tool.
    """

    def __init__(self, engine: Engine, index: EntityIndex, body: int) -> None:
        self.body = body
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
        self._qpos_adr = model.jnt_qposadr[self._joints]
        self._shared: tuple[list[F64], list[F64], F64] | None = None

    @property
    def is_shared(self) -> bool:
        """Whether all environments have the same transforms."""
        return all(len(self._engine.model_values(name)) == 1 for name in _FIELDS)

    @property
    def reach(self) -> float:
        """Metres: the length of all links, an upper bound of the tool's distance without slides."""
        return float(
            sum(np.linalg.norm(shift, axis=0).max() for shift in self._transforms(None)[1])
        )

    def frames(self, qpos: F64, env_ids: EnvIndex | None = None) -> Frames:
        """Compute the frames at joint positions.

        Args:
            qpos: (K, n) contiguous positions of the chain's joints, rad or m.
            env_ids: (n,) environments, or None for all; needed where model fields differ.
        """
        turns, shifts, zero = self._transforms(env_ids)
        count = qpos.shape[1]
        moved = qpos - zero
        cosines, sines = np.cos(moved), np.sin(moved)
        rotation = np.broadcast_to(turns[0], (3, 3, count))
        position = np.broadcast_to(shifts[0], (3, count))
        axes, anchors = np.empty((2, len(moved), 3, count))
        for joint, hinge in enumerate(self.hinges):
            axes[joint], anchors[joint] = rotation[:, 2], position
            if hinge:
                c, s = cosines[joint], sines[joint]
                x, y = rotation[:, 0], rotation[:, 1]
                rotation = np.stack([x * c + y * s, y * c - x * s, rotation[:, 2]], axis=1)
            else:
                position = position + rotation[:, 2] * moved[joint]
            position = position + matmul(rotation, shifts[joint + 1])
            rotation = matmul(rotation, turns[joint + 1])
        return Frames(rotation, position, axes, anchors)

    def jacobian(self, frames: Frames) -> F64:
        """(6, K, n) velocity of the tool's origin, then angular velocity, per joint velocity."""
        axes, anchors = np.swapaxes(frames.axes, 0, 1), np.swapaxes(frames.anchors, 0, 1)
        arm = frames.position[:, None] - anchors
        turning = np.stack(
            [
                axes[1] * arm[2] - axes[2] * arm[1],
                axes[2] * arm[0] - axes[0] * arm[2],
                axes[0] * arm[1] - axes[1] * arm[0],
            ]
        )
        hinge = self.hinges[:, None]
        linear, angular = np.where(hinge, turning, axes), np.where(hinge, axes, 0.0)
        return np.concatenate([linear, angular])

    def _transforms(self, env_ids: EnvIndex | None) -> tuple[list[F64], list[F64], F64]:
        """Rotations (3, 3, n or 1), translations (3, n or 1) and zero positions (K, n or 1)."""
        fields = [self._engine.model_values(name) for name in _FIELDS]
        if all(len(values) == 1 for values in fields):
            if self._shared is None:
                self._shared = self._compute(fields)
            return self._shared
        chosen = [v if len(v) == 1 or env_ids is None else v[env_ids] for v in fields]
        return self._compute(chosen)

    def _compute(self, fields: Sequence[F64]) -> tuple[list[F64], list[F64], F64]:
        body_pos, body_quat, jnt_pos, jnt_axis, qpos0 = fields
        model = self._engine.model
        rows = max(len(values) for values in fields)
        turn, shift = np.tile(np.eye(3)[..., None], rows), np.zeros((3, rows))
        turns, shifts = [], []
        for body in self._bodies:
            shift = shift + matmul(turn, body_pos[:, body].T)
            turn = matmul(turn, np.moveaxis(quat_to_matrix(body_quat[:, body]), 0, -1))
            for joint in _joints_of(model, body):
                to_axis = _from_z(jnt_axis[:, joint])
                back = np.swapaxes(to_axis, 0, 1)
                hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
                anchor = jnt_pos[:, joint].T if hinge else np.zeros((3, 1))
                shifts.append(shift + matmul(turn, anchor))
                turns.append(matmul(turn, to_axis))
                turn, shift = back, matmul(back, -anchor)
        return [*turns, turn], [*shifts, shift], qpos0[:, self._qpos_adr].T


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
