"""Quaternions (wxyz), rotation matrices and 7-vector poses, elementwise and batched.

The functions work on numpy arrays and torch tensors alike, over leading dimensions. Every one is
elementwise arithmetic in a fixed order, so a row's result does not depend on how many rows there
are; there is no matrix product here on purpose.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "cross",
    "euler_xyz_to_quat",
    "matrix_to_pose",
    "matrix_to_quat",
    "normalize_quat",
    "pose_to_matrix",
    "quat_conjugate",
    "quat_multiply",
    "quat_rotate",
    "quat_to_matrix",
]

A = TypeVar("A")


def _stack(parts: list[Any]) -> Any:
    if isinstance(parts[0], (np.ndarray, np.generic, float)):
        return np.stack(parts, axis=-1)
    import torch

    return torch.stack(parts, dim=-1)


def quat_multiply(a: A, b: A) -> A:
    """Hamilton product of wxyz quaternions, (..., 4)."""
    aw, ax, ay, az = (a[..., i] for i in range(4))  # type: ignore[index]
    bw, bx, by, bz = (b[..., i] for i in range(4))  # type: ignore[index]
    return _stack(  # type: ignore[no-any-return]
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ]
    )


def quat_conjugate(q: A) -> A:
    """Inverse rotation of unit wxyz quaternions, (..., 4)."""
    return _stack([q[..., 0], -q[..., 1], -q[..., 2], -q[..., 3]])  # type: ignore[index, no-any-return]


def cross(a: A, b: A) -> A:
    """Cross product, (..., 3)."""
    ax, ay, az = (a[..., i] for i in range(3))  # type: ignore[index]
    bx, by, bz = (b[..., i] for i in range(3))  # type: ignore[index]
    return _stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])  # type: ignore[no-any-return]


def quat_rotate(q: A, v: A) -> A:
    """Rotate vectors (..., 3) by unit wxyz quaternions (..., 4): v + 2w(u x v) + 2u x (u x v)."""
    u = q[..., 1:]  # type: ignore[index]
    t = 2.0 * cross(u, v)
    return v + q[..., :1] * t + cross(u, t)  # type: ignore[no-any-return, index]


def normalize_quat(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit quaternions, (..., 4).

    Raises:
        ValueError: If one is zero or not finite.
    """
    s = q * q
    norm = np.sqrt(s[..., 0] + s[..., 1] + s[..., 2] + s[..., 3])
    # Not finite: the smallest or the largest is not (a NaN is both).
    if norm.size and not 1e-9 < norm.min() <= norm.max() < np.inf:
        raise ValueError("a quaternion is zero or not finite; wxyz with unit length is wanted")
    return q / norm[..., None]


def quat_to_matrix(q: A) -> A:
    """Rotation matrices (..., 3, 3) of unit wxyz quaternions (..., 4)."""
    w, x, y, z = (q[..., i] for i in range(4))  # type: ignore[index]
    rows = [
        _stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
        _stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
        _stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
    ]
    if isinstance(rows[0], np.ndarray):
        return np.stack(rows, axis=-2)  # type: ignore[return-value]
    import torch

    return torch.stack(rows, dim=-2)  # type: ignore[return-value]


# 4 q q^T of a rotation matrix: each entry is a constant plus three entries of the matrix, at these
# places of its nine and with these signs (4 qw qx = m21 - m12, 4 qw qw = 1 + m00 + m11 + m22...).
_PLACES = np.array(
    [
        [[0, 4, 8], [7, 5, 0], [2, 6, 0], [3, 1, 0]],
        [[7, 5, 0], [0, 4, 8], [3, 1, 0], [2, 6, 0]],
        [[2, 6, 0], [3, 1, 0], [0, 4, 8], [7, 5, 0]],
        [[3, 1, 0], [2, 6, 0], [7, 5, 0], [0, 4, 8]],
    ]
)
_SIGNS = np.array(
    [
        [[1, 1, 1], [1, -1, 0], [1, -1, 0], [1, -1, 0]],
        [[1, -1, 0], [1, -1, -1], [1, 1, 0], [1, 1, 0]],
        [[1, -1, 0], [1, 1, 0], [-1, 1, -1], [1, 1, 0]],
        [[1, -1, 0], [1, 1, 0], [1, 1, 0], [-1, -1, 1]],
    ],
    np.float64,
)
_TAKEN = np.ascontiguousarray(np.moveaxis(_PLACES, -1, 0).reshape(-1))
_SIGNED = np.ascontiguousarray(np.moveaxis(_SIGNS, -1, 0).reshape(3, 16))
_UNIT = np.eye(4).reshape(16)
_UNTURNED = np.eye(3).tobytes()


def matrix_to_quat(m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit wxyz quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    Shepperd's method: divide by the largest of the four components, so no case is ill-conditioned
    (S. W. Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1(3), 1978).
    """
    flat = np.asarray(m, np.float64).reshape(-1, 9)
    count = len(flat)
    if flat.tobytes() == _UNTURNED * count:  # as most poses written from Python are: a tenth
        q = np.zeros((count, 4))
        q[:, 0] = 1.0
        return q.reshape(*m.shape[:-2], 4)
    terms = flat[:, _TAKEN].reshape(count, 3, 16)
    terms *= _SIGNED
    products = (_UNIT + terms[:, 0] + terms[:, 1] + terms[:, 2]).reshape(count, 16)
    best = products[:, ::5].argmax(axis=1)
    q = normalize_quat(products.reshape(count, 4, 4)[np.arange(count), best])
    q *= np.where(q[:, :1] < 0, -1.0, 1.0)
    return q.reshape(*m.shape[:-2], 4)


def euler_xyz_to_quat(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wxyz quaternions of intrinsic XYZ Euler angles in radians (R = Rx Ry Rz), (..., 3)."""
    half = 0.5 * np.ascontiguousarray(np.moveaxis(np.asarray(angles, np.float64), -1, 0))
    (cx, cy, cz), (sx, sy, sz) = np.cos(half), np.sin(half)
    return np.stack(
        [
            cx * cy * cz - sx * sy * sz,
            sx * cy * cz + cx * sy * sz,
            cx * sy * cz - sx * cy * sz,
            cx * cy * sz + sx * sy * cz,
        ],
        axis=-1,
    )


def pose_to_matrix(pose: A) -> A:
    """4x4 matrices of 7-vectors (x, y, z, qw, qx, qy, qz), (..., 7) -> (..., 4, 4)."""
    rotation = quat_to_matrix(pose[..., 3:])  # type: ignore[index]
    shape = (*pose.shape[:-1], 4, 4)  # type: ignore[attr-defined]
    if isinstance(pose, np.ndarray):
        out: Any = np.zeros(shape, pose.dtype)
    else:
        out = pose.new_zeros(shape)  # type: ignore[attr-defined]
    out[..., :3, :3] = rotation
    out[..., :3, 3] = pose[..., :3]  # type: ignore[index]
    out[..., 3, 3] = 1.0
    return out  # type: ignore[no-any-return]


def matrix_to_pose(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """7-vectors (x, y, z, qw, qx, qy, qz) of 4x4 matrices, (..., 4, 4) -> (..., 7)."""
    quat = matrix_to_quat(matrix[..., :3, :3])
    return np.concatenate([matrix[..., :3, 3], quat], axis=-1)
