"""Quaternions (wxyz), rotation matrices and 7-vector poses: arrays of floats, batched.

All functions use elementwise arithmetic in a fixed order, without matrix products, so that a row's
result does not depend on the number of rows. Products of all pairs of components are computed in
one call and then selected: with few environments the number of numpy calls determines the cost.
A sum of squares is a dot product of each contiguous row: its rounding does not depend on the number
of rows either, unlike that of a numpy reduction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.array_types import Floats
from embodichain.utils.arrays import contiguous, is_host, zeros

__all__ = [
    "cross",
    "euler_xyz_to_quat",
    "look_at",
    "matrix_to_pose",
    "matrix_to_quat",
    "norm",
    "normalize_quat",
    "pose_to_matrix",
    "quat_conjugate",
    "quat_multiply",
    "quat_rotate",
    "quat_to_matrix",
    "quat_to_rotvec",
    "quat_to_rpy",
    "rotate",
    "rotate_back",
    "rotvec_to_quat",
    "rpy_to_quat",
    "squares",
    "wrapped",
]

# Indices (4 i + j) and signs of products a[i] b[j] of two quaternions; each row is a component of
# the Hamilton product.
_HAMILTON = np.array([[0, 5, 10, 15], [1, 4, 11, 14], [2, 7, 8, 13], [3, 6, 9, 12]])
_HAMILTON_SIGNS = np.array([[1.0, -1, -1, -1], [1, 1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1]])
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
# Each matrix entry is a constant plus a factor times the sum or difference of two products of a
# quaternion's components.
_FIRST = np.array([10, 6, 7, 6, 5, 11, 7, 11, 5])
_SECOND = np.array([15, 3, 2, 3, 15, 1, 2, 1, 10])
_SECOND_SIGN = np.array([[1.0, -1, 1, 1, 1, -1, -1, 1, 1]]).T
_FACTOR = np.array([[-2.0, 2, 2, 2, -2, 2, 2, 2, -2]]).T
_IDENTITY = np.eye(3).reshape(9, 1)
# Likewise for the 9 products a[i] b[j] of two vectors.
_CROSS_PLUS = np.array([5, 6, 1])
_CROSS_MINUS = np.array([7, 2, 3])


def _floats(values: Any) -> Floats:
    """Numbers as float64, on a device in the type that they have."""
    return np.asarray(values, np.float64) if is_host(values) else values


def _products(a: Floats, b: Floats) -> Floats:
    """All products a[i] b[j], (..., n^2), of vectors (..., n)."""
    pairs = a[..., :, None] * b[..., None, :]
    # Not -1: of an array without rows it is undetermined.
    return pairs.reshape(*pairs.shape[:-2], pairs.shape[-2] * pairs.shape[-1])


def squares(vectors: NDArray[Any]) -> Floats:
    """Sum of the squares of the rows, (N, ..., K) -> (N, ...)."""
    if type(vectors) is np.ndarray:
        rows = np.ascontiguousarray(vectors, np.float64)
    else:
        rows = contiguous(vectors, np.float64)
    return np.vecdot(rows, rows)


def norm(vectors: NDArray[Any]) -> Floats:
    """Euclidean length of the rows, (N, ..., K) -> (N, ...)."""
    return np.sqrt(squares(vectors))


def quat_multiply(a: Floats, b: Floats) -> Floats:
    """Hamilton product of wxyz quaternions, (..., 4)."""
    terms = _products(a, b).take(_HAMILTON, -1) * _HAMILTON_SIGNS
    return terms[..., 0] + terms[..., 1] + terms[..., 2] + terms[..., 3]


def quat_conjugate(q: Floats) -> Floats:
    """Inverse rotation of unit wxyz quaternions, (..., 4)."""
    return q * _CONJUGATE


def cross(a: Floats, b: Floats) -> Floats:
    """Cross product, (..., 3)."""
    products = _products(a, b)
    return products.take(_CROSS_PLUS, -1) - products.take(_CROSS_MINUS, -1)


def quat_rotate(q: Floats, v: Floats) -> Floats:
    """Rotate vectors (..., 3) by unit wxyz quaternions (..., 4): v + 2w(u x v) + 2u x (u x v)."""
    u = q[..., 1:]
    t = 2.0 * cross(u, v)
    return v + q[..., :1] * t + cross(u, t)


def rotate(matrix: Floats, v: Floats) -> Floats:
    """Rotate vectors (..., 3) by rotation matrices (..., 3, 3)."""
    parts = matrix * v[..., None, :]
    return parts[..., 0] + parts[..., 1] + parts[..., 2]


def rotate_back(matrix: Floats, v: Floats) -> Floats:
    """Rotate vectors (..., 3) by the inverses of rotation matrices (..., 3, 3)."""
    parts = matrix * v[..., :, None]
    return parts[..., 0, :] + parts[..., 1, :] + parts[..., 2, :]


def normalize_quat(q: Floats) -> Floats:
    """Return unit quaternions, (..., 4).

    Raises:
        ValueError: If one is zero or not finite.
    """
    s = q * q
    norm = np.sqrt(s[..., 0] + s[..., 1] + s[..., 2] + s[..., 3])
    # If a value is not finite, the smallest or the largest is not (NaN is both).
    if is_host(norm) and norm.size and not 1e-9 < norm.min() <= norm.max() < np.inf:
        raise ValueError("a quaternion is zero or not finite; wxyz with unit length is wanted")
    return q / norm[..., None]


def quat_to_matrix(q: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of unit wxyz quaternions (..., 4)."""
    # A row for each component, so that constants broadcast along contiguous rows.
    rows = contiguous(q.reshape(-1, 4).T)
    products = (rows[:, None] * rows).reshape(16, -1)
    sums = products.take(_FIRST, 0) + _SECOND_SIGN * products.take(_SECOND, 0)
    return (_IDENTITY + _FACTOR * sums).T.reshape(*q.shape[:-1], 3, 3)


# 4 q q^T of a rotation matrix: each entry is a constant plus three entries of the matrix, at these
# indices and with these signs (4 qw qx = m21 - m12, 4 qw qw = 1 + m00 + m11 + m22...).
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
_TAKEN = contiguous(np.moveaxis(_PLACES, -1, 0).reshape(-1))
_SIGNED = contiguous(np.moveaxis(_SIGNS, -1, 0).reshape(3, 16))
_UNIT = np.eye(4).reshape(16)
_UNTURNED = np.eye(3).tobytes()


def matrix_to_quat(m: Floats) -> Floats:
    """Unit wxyz quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    Shepperd's method: divide by the largest of the four components, so no case is ill-conditioned
    (S. W. Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1(3), 1978).
    """
    flat = _floats(m).reshape(-1, 9)
    count = len(flat)
    if (
        is_host(flat) and flat.tobytes() == _UNTURNED * count
    ):  # most poses set from Python: 10 times faster
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


def euler_xyz_to_quat(angles: Floats) -> Floats:
    """Wxyz quaternions of intrinsic XYZ Euler angles in radians (R = Rx Ry Rz), (..., 3)."""
    half = 0.5 * contiguous(np.moveaxis(_floats(angles), -1, 0))
    cx, cy, cz = np.cos(half)
    sx, sy, sz = np.sin(half)
    return np.stack(
        [
            cx * cy * cz - sx * sy * sz,
            sx * cy * cz + cx * sy * sz,
            cx * sy * cz - sx * cy * sz,
            cx * cy * sz + sx * sy * cz,
        ],
        axis=-1,
    )


def rpy_to_quat(angles: Floats) -> Floats:
    """Wxyz quaternions of roll, pitch, yaw in rad about fixed axes, R = Rz Ry Rx, (..., 3)."""
    return quat_conjugate(euler_xyz_to_quat(-angles))


def quat_to_rpy(quats: Floats) -> Floats:
    """Roll, pitch, yaw about fixed axes (R = Rz Ry Rx) in rad, (..., 3), of unit wxyz quaternions.

    At a pitch of +-90 degrees, where only the sum or difference of the other two counts, they still
    give the same rotation: roll is found with the yaw taken away.
    """
    w, x, y, z = contiguous(np.moveaxis(_floats(quats), -1, 0))
    m00 = 1.0 - 2.0 * (y * y + z * z)
    m01 = 2.0 * (x * y - w * z)
    m02 = 2.0 * (x * z + w * y)
    m10 = 2.0 * (x * y + w * z)
    m11 = 1.0 - 2.0 * (x * x + z * z)
    m12 = 2.0 * (y * z - w * x)
    m20 = 2.0 * (x * z - w * y)
    yaw = np.arctan2(m10, m00)
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    pitch = np.arctan2(-m20, cos * m00 + sin * m10)
    roll = np.arctan2(sin * m02 - cos * m12, cos * m11 - sin * m01)
    return np.stack([roll, pitch, yaw], axis=-1)


def rotvec_to_quat(vectors: Floats) -> Floats:
    """Wxyz quaternions of rotation vectors (axis times angle in rad), (..., 3)."""
    x, y, z = contiguous(np.moveaxis(_floats(vectors), -1, 0))
    angle = np.sqrt(x * x + y * y + z * z)
    half = 0.5 * angle
    # sin(half) / angle tends to 1/2 for small angles.
    factor = np.divide(np.sin(half), angle, out=np.full_like(angle, 0.5), where=angle > 1e-9)
    return np.stack([np.cos(half), factor * x, factor * y, factor * z], axis=-1)


def quat_to_rotvec(quats: Floats) -> Floats:
    """Rotation vectors (axis times angle in rad, at most pi), (..., 3), of unit quaternions."""
    w, x, y, z = contiguous(np.moveaxis(quats, -1, 0))
    sine = np.sqrt(x * x + y * y + z * z)
    angle = 2.0 * np.arctan2(sine, np.abs(w))
    # angle / sine tends to 2 for small angles.
    factor = np.divide(angle, sine, out=np.full_like(w, 2.0), where=sine > 1e-9)
    factor = np.where(w < 0.0, -factor, factor)
    return np.stack([x * factor, y * factor, z * factor], axis=-1)


def wrapped(angles: Floats) -> Floats:
    """Angles (...) wrapped to [-pi, pi) rad."""
    turn = 2.0 * np.pi
    return angles - turn * np.floor((angles + np.pi) / turn)


def look_at(eye: Floats, target: Floats, up: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of cameras that look from one point to another.

    Columns are the camera's axes right, up and backwards (OpenGL). Where `up` is parallel to the
    view, x is up, or y.

    Args:
        eye: (..., 3).
        target: (..., 3).
        up: (..., 3) the direction that is up in the picture.

    Raises:
        ValueError: If an eye is at its target.
    """
    back = np.asarray(eye - target, np.float64)
    length = np.sqrt((back * back).sum(axis=-1, keepdims=True))
    if (length < 1e-9).any():
        raise ValueError(f"the eye is at the target, {np.asarray(eye).tolist()}")
    back = back / length
    right = np.zeros_like(back)
    is_done = np.zeros(length.shape, np.bool_)
    for upwards in (np.asarray(up, np.float64), np.eye(3)[0], np.eye(3)[1]):
        side = cross(np.broadcast_to(upwards, back.shape), back)
        size = np.sqrt((side * side).sum(axis=-1, keepdims=True))
        right = np.where(~is_done & (size > 1e-6), side / np.maximum(size, 1e-6), right)
        is_done = is_done | (size > 1e-6)
    return np.stack([right, cross(back, right), back], axis=-1)


def pose_to_matrix(pose: Floats) -> Floats:
    """4x4 matrices of 7-vectors (x, y, z, qw, qx, qy, qz), (..., 7) -> (..., 4, 4)."""
    out = zeros((*pose.shape[:-1], 4, 4), pose)
    out[..., :3, :3] = quat_to_matrix(pose[..., 3:])
    out[..., :3, 3] = pose[..., :3]
    out[..., 3, 3] = 1.0
    return out


def matrix_to_pose(matrix: Floats) -> Floats:
    """7-vectors (x, y, z, qw, qx, qy, qz) of 4x4 matrices, (..., 4, 4) -> (..., 7)."""
    quat = matrix_to_quat(matrix[..., :3, :3])
    return np.concatenate([matrix[..., :3, 3], quat], axis=-1)
