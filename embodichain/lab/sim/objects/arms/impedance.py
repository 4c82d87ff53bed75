"""`Impedance`: joint efforts of a spring and a damper between a tool and a pose.

Environments are in the last axis, as in `chain`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.sim.objects.arms.arm_dynamics import in_axes, matrix_product
from embodichain.lab.sim.solvers.least_squares import eliminated, squared, times, transposed
from embodichain.utils.arrays import contiguous, is_host, precise
from embodichain.utils.math import quat_conjugate, quat_multiply, quat_to_rotvec

if TYPE_CHECKING:
    from embodichain.lab.sim.objects.arms.arm_dynamics import ArmDynamics
    from embodichain.utils.array_types import Floats

__all__ = ["Impedance"]

_LEAST_MOBILITY = 1e-4
"""1/kg or 1/(kg m^2), added to the tool's mobility in each direction: finite near singularities."""


class Impedance:
    """Operational space control of a tool, with a posture in the null space.

    tau = J^T L (K e - D v - J a) + M a + b, with the tool's Jacobian J, the mass matrix M of the
    joints, L = (J M^-1 J^T)^-1, the error e of the pose, the tool's velocity v, accelerations a
    towards the posture, and the bias b. K and D = 2 r sqrt(K) are diagonal. O. Khatib, "A unified
    approach for motion and force control of robot manipulators: the operational space
    formulation", IEEE Journal of Robotics and Automation 3(1), 1987.

    Without decoupling tau = J^T (K e - D v - L J a) + M a + b, with D = 2 sqrt(r) (L # K) sqrt(r)
    and the geometric mean L # K = sqrt(K) (sqrt(K) L^-1 sqrt(K))^(-1/2) sqrt(K). With r = 1 it
    damps all modes of L and K critically: double diagonalization, A. Albu-Schaeffer et al.,
    "Cartesian impedance control of redundant robots", ICRA 2003.

    Args:
        dynamics: The k joints and their tool.
        stiffness: (6,) K of x, y, z, rx, ry, rz; (3,) if the orientation is free. 1/s^2, without
            decoupling N/m and N m/rad.
        ratio: Damping ratios r, likewise.
        most: Largest lengths of the errors of position and rotation that the spring pulls with, m
            and rad.
        decoupling: Whether L shapes the forces.
        posture: (k,) joint positions.
        pull: 1/s^2 towards the posture, critically damped; 0 means no posture.
    """

    def __init__(
        self,
        dynamics: ArmDynamics,
        stiffness: Floats,
        ratio: Floats,
        most: tuple[float, float],
        decoupling: bool,
        posture: Floats,
        pull: float,
    ) -> None:
        self._dynamics = dynamics
        self._most = most
        self._decouples = decoupling

        # The spring and the damper of the tool.
        root = np.sqrt(stiffness[:, None])
        self._stiffness: Floats = stiffness[:, None]
        self._root: Floats = root
        self._damping: Floats = 2.0 * ratio[:, None] * root
        self._weight: Floats = np.sqrt(ratio)[:, None] * root

        # Those of the posture.
        self._posture: Floats = posture[:, None]
        self._pull = pull
        self._brake = 2.0 * np.sqrt(pull)

    def error(self, pos: Floats, quat: Floats | None) -> Floats:
        """(6, N) from the tool to poses (N, 3), (N, 4), world axes; (3, N) without orientation.

        The rotation vector is the logarithm of R_target R_tool^T.
        """
        pose = self._dynamics.pose()
        error = pos - pose[:, :3]
        if quat is not None:
            turn = quat_multiply(quat, quat_conjugate(pose[:, 3:]))
            error = np.concatenate([error, quat_to_rotvec(turn)], axis=1)
        return contiguous(error.T)

    def efforts(self, error: Floats, axes: Floats | None) -> Floats:
        """(k, N) efforts for the engine's current state, N m or N.

        Args:
            error: (6 or 3, N) from `error`.
            axes: (N, 4) orientation of the axes of stiffness, wxyz; None is the world's axes.
        """
        size = len(error)
        # Of position, and of rotation where it has one.
        parts = zip(error.reshape(-1, 3, error.shape[-1]), self._most, strict=False)
        error = np.concatenate([_shortened(part, length) for part, length in parts])
        jacobian = self._dynamics.jacobian()[:size]
        velocity = self._dynamics.velocity()[:size]
        if axes is not None:
            jacobian = in_axes(axes, jacobian)
            velocity = in_axes(axes, velocity)
            error = in_axes(axes, error)
        mass = self._dynamics.mass_matrix()
        mobility = matrix_product(jacobian, _solved(mass, np.swapaxes(jacobian, 0, 1)))
        mobility[np.arange(size), np.arange(size)] += _LEAST_MOBILITY

        lean = self._lean() if self._pull else None
        force = self._stiffness * error
        if self._decouples:
            acceleration = force - self._damping * velocity
            if lean is not None:
                acceleration = acceleration - times(jacobian, lean)
            force = _solved(mobility, acceleration)
        else:
            force = force - self._damping_force(mobility, velocity)
            if lean is not None:
                force = force - _solved(mobility, times(jacobian, lean))
        effort = self._dynamics.bias() + transposed(jacobian, force)
        if lean is not None:
            effort = effort + times(mass, lean)
        return effort

    def _damping_force(self, mobility: Floats, velocity: Floats) -> Floats:
        """(r, N) forces of the damper without decoupling."""
        scaled = np.moveaxis(self._root[:, None] * mobility * self._root[None], -1, 0)
        # eigh raises for NaN, which the velocity of an environment that diverged has as well.
        is_finite = np.isfinite(scaled).all(axis=(1, 2), keepdims=True)
        squares, modes = np.linalg.eigh(np.where(is_finite, scaled, 0.0))
        is_stiff = squares > 1e-12 * squares[:, -1:]  # the others are axes without stiffness
        rate = np.where(is_stiff, 1.0 / np.sqrt(np.where(is_stiff, squares, 1.0)), 0.0)
        modes = contiguous(np.moveaxis(modes, 0, -1))
        in_modes = transposed(modes, self._weight * velocity) * contiguous(rate.T)
        return 2.0 * self._weight * times(modes, in_modes)

    def _lean(self) -> Floats:
        """(k, N) accelerations towards the posture."""
        qpos, qvel = self._dynamics.joint_motion()
        return self._pull * (self._posture - qpos) - self._brake * qvel


def _shortened(vectors: Floats, length: float) -> Floats:
    """Vectors (3, N), scaled to a length where they are longer."""
    return vectors * (length / np.maximum(np.sqrt(squared(vectors)), length))


def _solved(matrix: Floats, right: Floats) -> Floats:
    """Solutions of N systems (k, k, N), (k, ..., N); on the host LAPACK solves each alone."""
    vectors = right if right.ndim == 3 else right[:, None]
    if not is_host(matrix):
        system = np.concatenate([precise(matrix), precise(vectors)], axis=1)
        return eliminated(system).reshape(right.shape)
    solution = np.linalg.solve(np.moveaxis(matrix, -1, 0), np.moveaxis(vectors, -1, 0))
    return contiguous(np.moveaxis(solution, 0, -1)).reshape(right.shape)
