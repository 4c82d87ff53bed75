"""`Chain`: forward kinematics and Jacobian of the joints between a root and a tool.

Arrays here have the environments in the last axis, so that every operation runs along contiguous
rows. All arithmetic is elementwise in a fixed order: a result does not depend on the number of
environments.
"""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from dataclasses import dataclass
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
# Components of the factors of a cross product.
_NEXT = np.array([1, 2, 0])
_LAST = np.array([2, 0, 1])


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


@dataclass(frozen=True, eq=False)
class _Constants:
    """What the model says of a chain; n is 1 where all environments have the same.

    Attributes:
        transforms: (K + 1, 3, 4, n) F[0] ... F[K], see `Chain`.
        zero: (K, n) joint positions at which these hold, rad or m.
    """

    transforms: F64
    zero: F64


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
        self.body = int(self.tool.bodies)
        # Solvers are parts of cycles: a closed environment must not wait for the collector.
        self._engine: Engine = weakref.proxy(engine)
        self._fields: tuple[str, ...] = _FIELDS
        if self.tool.kind != "link":
            self._fields += (f"{self.tool.kind}_pos", f"{self.tool.kind}_quat")

        # Bodies and MuJoCo's joints from the root to the tool.
        model = engine.model
        self._bodies = _bodies_between(model, index.root_body_id, self.body)
        self._joints: list[int] = []
        for body in self._bodies:
            self._joints += _joints_of(model, body)
        kinds = model.jnt_type[self._joints]
        is_hinge = kinds == mujoco.mjtJoint.mjJNT_HINGE
        is_slide = kinds == mujoco.mjtJoint.mjJNT_SLIDE
        is_ball = ~(is_hinge | is_slide)
        if is_ball.any():
            name = model.joint(self._joints[int(np.argmax(is_ball))]).name
            message = f"{name!r} between the root and the tool is a ball joint"
            raise ConfigError([Problem("link_names", message)])

        joint_of_dof = {int(dof): joint for joint, dof in enumerate(index.dof_adr)}
        dofs = model.jnt_dofadr[self._joints].tolist()
        self.joints: NDArray[np.int64] = np.array([joint_of_dof[dof] for dof in dofs], np.int64)
        self.hinges: NDArray[np.bool_] = is_hinge
        self._slides = np.flatnonzero(is_slide)
        self._qpos_adr = model.jnt_qposadr[self._joints]
        self._shared: _Constants | None = None

    @property
    def is_shared(self) -> bool:
        """Whether all environments have the same transforms."""
        return all(len(self._engine.model_values(name)) == 1 for name in self._fields)

    @property
    def reach(self) -> float:
        """Metres: the length of all links, an upper bound of the tool's distance without slides."""
        shifts = self._constants(None).transforms[:, :, 3]
        return float(np.linalg.norm(shifts, axis=1).max(axis=1).sum())

    def frames(self, qpos: F64, env_ids: EnvIndex | None = None) -> Frames:
        """Compute the frames at joint positions.

        Args:
            qpos: (K, n) contiguous positions of the chain's joints, rad or m.
            env_ids: (n,) environments, or None for all; needed where model fields differ.
        """
        constants = self._constants(env_ids)
        transforms = constants.transforms
        moved = qpos - constants.zero
        angles = moved
        if len(self._slides):
            angles = np.where(self.hinges[:, None], moved, 0.0)
        cosines = np.cos(angles)[:, None]
        sines = np.sin(angles)[:, None]
        count, size = moved.shape
        # Z(q[j]) F[j + 1] of every joint, then their products.
        moves = np.empty_like(moved, shape=(count, 3, 4, size))
        x = transforms[1:, 0]
        y = transforms[1:, 1]
        moves[:, 0] = x * cosines - y * sines
        moves[:, 1] = x * sines + y * cosines
        moves[:, 2] = transforms[1:, 2]
        for slide in self._slides:
            moves[slide, 2, 3] += moved[slide]
        poses = np.empty_like(moved, shape=(count + 1, 3, 4, size))
        poses[0] = transforms[0]
        for pose, move, product in zip(poses, moves, poses[1:], strict=False):
            parts = pose[:, :3, None] * move
            np.add(parts[:, 0], parts[:, 1], out=product)
            product += parts[:, 2]
            shift = product[:, 3]
            shift += pose[:, 3]
        return Frames(
            rotation=poses[-1, :, :3],
            position=poses[-1, :, 3],
            axes=poses[:-1, :, 2],
            anchors=poses[:-1, :, 3],
        )

    def jacobian(self, frames: Frames) -> F64:
        """(6, K, n) velocity of the tool's origin, then angular velocity, per joint velocity."""
        axes = np.swapaxes(frames.axes, 0, 1)
        anchors = np.swapaxes(frames.anchors, 0, 1)
        arm = frames.position[:, None] - anchors
        jacobian = np.empty_like(frames.position, shape=(6, *axes.shape[1:]))
        linear = jacobian[:3]
        linear[...] = axes.take(_NEXT, 0) * arm.take(_LAST, 0)
        linear -= axes.take(_LAST, 0) * arm.take(_NEXT, 0)
        jacobian[3:] = axes
        for slide in self._slides:
            jacobian[:3, slide] = axes[:, slide]
            jacobian[3:, slide] = 0.0
        return jacobian

    def _constants(self, env_ids: EnvIndex | None) -> _Constants:
        """Return the constants of some environments, computed once where all have the same."""
        if self._shared is not None and not self._engine.models_may_differ:
            return self._shared
        fields = [self._engine.model_values(name) for name in self._fields]
        if all(len(values) == 1 for values in fields):
            if self._shared is None:
                self._shared = self._compute(fields)
            return self._shared
        if env_ids is not None:
            fields = [values if len(values) == 1 else values[env_ids] for values in fields]
        return self._compute(fields)

    def _compute(self, fields: Sequence[F64]) -> _Constants:
        """Walk from the root to the tool.

        Args:
            fields: (n or 1, ...) values of the fields `_fields`.
        """
        body_pos, body_quat, jnt_pos, jnt_axis, qpos0, *of_tool = fields
        model = self._engine.model
        count = max(len(values) for values in fields)
        # The pose reached so far, in the frame after the last joint.
        turn = np.tile(np.eye(3)[..., None], count)
        shift = np.zeros((3, count))
        transforms: list[F64] = []
        for body in self._bodies:
            shift = shift + matmul(turn, body_pos[:, body].T)
            turn = matmul(turn, np.moveaxis(quat_to_matrix(body_quat[:, body]), 0, -1))
            for joint in _joints_of(model, body):
                to_axis = _from_z(jnt_axis[:, joint])
                is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
                # Where the axis of a slide lies makes no difference.
                anchor = jnt_pos[:, joint].T if is_hinge else np.zeros((3, 1))
                rotation = matmul(turn, to_axis)
                transforms.append(_pose(rotation, shift + matmul(turn, anchor), count))
                turn = np.swapaxes(to_axis, 0, 1)
                shift = matmul(turn, -anchor)
        if of_tool:
            pos, quat = (values[:, self.tool.ids] for values in of_tool)
            shift = shift + matmul(turn, pos.T)
            turn = matmul(turn, np.moveaxis(quat_to_matrix(quat), 0, -1))
        transforms.append(_pose(turn, shift, count))
        return _Constants(np.stack(transforms), qpos0[:, self._qpos_adr].T)


def _pose(rotation: F64, position: F64, count: int) -> F64:
    """(3, 4, count) of a rotation (3, 3, count or 1) and a position (3, count or 1)."""
    pose = np.empty((3, 4, count))
    pose[:, :3] = rotation
    pose[:, 3] = position
    return pose


def _bodies_between(model: mujoco.MjModel, root: int, body: int) -> list[int]:
    """Return the bodies below a root, down to one of them."""
    bodies: list[int] = []
    while body != root:
        bodies.insert(0, body)
        body = int(model.body_parentid[body])
    return bodies


def _joints_of(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _from_z(axis: F64) -> F64:
    """(3, 3, n) rotations that turn z to unit vectors (n, 3), by the shorter way."""
    x, y, z = axis.T
    is_below = z <= -1.0 + 1e-12  # any half turn about a level axis does
    half = np.stack(
        [
            np.where(is_below, 0.0, 1.0 + z),
            np.where(is_below, 1.0, -y),
            np.where(is_below, 0.0, x),
        ]
    )
    half = half / np.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
    quat = np.concatenate([half, np.zeros((1, len(axis)))]).T
    return np.moveaxis(quat_to_matrix(quat), 0, -1)
