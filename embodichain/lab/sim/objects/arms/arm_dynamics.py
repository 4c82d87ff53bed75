"""`ArmDynamics`: mass matrix, bias forces, Jacobian and motion of a tool, from the engine's fields.

Environments are in the last axis, as in `chain`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.sim.reads.frames import link_frame
from embodichain.lab.sim.solvers.chain import matmul
from embodichain.utils.arrays import contiguous
from embodichain.utils.math import quat_conjugate, quat_to_matrix

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.reads.frames import BodyFrames
    from embodichain.utils.array_types import Floats

__all__ = ["ArmDynamics", "in_axes", "matrix_product"]


def matrix_product(a: Floats, b: Floats) -> Floats:
    """(r, s, n) products of matrices (r, k, n) and (k, s, n), elementwise in a fixed order."""
    result: Floats = a[:, 0, None] * b[None, 0]
    for inner in range(1, a.shape[1]):
        result = result + a[:, inner, None] * b[None, inner]
    return result


class ArmDynamics:
    """Dynamics of some joints of an articulation, and the motion of the body that they move.

    Everything is that of the engine's current state; its position and velocity stages run if it
    has changed. Other joints are as if they were fixed: their rows and columns of the mass matrix
    are left out.

    Args:
        asset: The articulation.
        joints: k of the joints between its root and the tool.
        tool: The frame of the tool; a number is MuJoCo's id of a body.
    """

    def __init__(self, asset: Articulation, joints: Sequence[int], tool: BodyFrames | int) -> None:
        model = asset.engine.model
        self._asset = asset
        self._engine = asset.engine
        self._tool = link_frame(tool) if isinstance(tool, int) else tool
        self._root = int(model.body_rootid[int(self._tool.bodies)])
        self._joints: NDArray[np.int64] = np.asarray(list(joints), np.int64)
        self._dofs: NDArray[np.int64] = asset.index.dof_adr[self._joints].astype(np.int64)
        self._entries = _find_entries(model, self._dofs.tolist())

    def mass_matrix(self) -> Floats:
        """(k, k, n) joint-space inertia with the joints' armature, kg m^2 (kg of slides)."""
        values = contiguous(self._engine.derived("M")[:, self._entries].T)
        size = len(self._dofs)
        return values.reshape(size, size, -1)

    def bias(self) -> Floats:
        """(k, n) efforts that balance gravity, Coriolis and centrifugal forces, N m or N.

        Less those that `gravcomp` of the links balances already.
        """
        bias = self._engine.derived("qfrc_bias")[:, self._dofs]
        bias = bias - self._engine.derived("qfrc_gravcomp")[:, self._dofs]
        return contiguous(bias.T)

    def jacobian(self) -> Floats:
        """(6, k, n) velocity of the tool's origin, then its angular velocity, in world axes.

        MuJoCo's `cdof` (angular, linear at the tree's centre of mass), moved to the origin.
        """
        engine = self._engine
        cdof = np.moveaxis(engine.derived("cdof")[:, self._dofs], 0, -1)  # (k, 6, n)
        arm = self._tool.positions(engine) - engine.derived("subtree_com")[:, self._root]
        x, y, z = arm.T
        angular = contiguous(np.moveaxis(cdof[:, :3], 1, 0))
        angular_x, angular_y, angular_z = angular
        # The cross product of angular velocity and arm.
        shift = np.stack(
            [
                angular_y * z - angular_z * y,
                angular_z * x - angular_x * z,
                angular_x * y - angular_y * x,
            ]
        )
        linear = np.moveaxis(cdof[:, 3:], 1, 0) + shift
        return np.concatenate([linear, angular])

    def joint_motion(self) -> tuple[Floats, Floats]:
        """Positions (k, n), rad or m, and velocities (k, n) of the joints."""
        qpos = self._asset.read_qpos()[:, self._joints]
        qvel = self._asset.read_qvel()[:, self._joints]
        return contiguous(qpos.T), contiguous(qvel.T)

    def pose(self) -> Floats:
        """(n, 7) x, y, z, qw, qx, qy, qz of the tool."""
        position = self._tool.positions(self._engine)
        orientation = self._tool.orientations(self._engine)
        return np.concatenate([position, orientation], axis=1)

    def velocity(self) -> Floats:
        """(6, n) velocity of the tool's origin, then its angular velocity, in world axes."""
        return contiguous(np.concatenate(self._tool.velocities(self._engine), axis=1).T)


def in_axes(axes: Floats, twists: Floats) -> Floats:
    """Twists or errors (6 or 3, ..., n) of world axes, in axes with orientations (n, 4), wxyz."""
    back = contiguous(np.moveaxis(quat_to_matrix(quat_conjugate(axes)), 0, -1))
    parts = twists.reshape(-1, 3, *twists.shape[1:])
    return np.concatenate([matmul(back, part) for part in parts])


def _find_entries(model: mujoco.MjModel, dofs: Sequence[int]) -> NDArray[np.int64]:
    """(k * k) places of the elements of a mass matrix in MuJoCo's sparse lower triangle `M`."""
    places = []
    for pair in product(dofs, repeat=2):
        row = max(pair)
        column = min(pair)
        start = int(model.M_rowadr[row])
        columns = model.M_colind[start : start + int(model.M_rownnz[row])].tolist()
        places.append(start + columns.index(column))
    return np.array(places, np.int64)
