"""Rotations against scipy's."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from embodichain.utils import math as m


@pytest.fixture
def rotations():
    random = Rotation.random(200, random_state=1)
    edges = Rotation.from_euler(
        "xyz", [[180, 0, 0], [0, 180, 0], [0, 0, 180], [0, 0, 0], [180, 1e-7, 0]], degrees=True
    )
    return Rotation.concatenate([random, edges])


def wxyz(rotation):
    q = rotation.as_quat()[:, [3, 0, 1, 2]]
    return np.where(q[:, :1] < 0, -q, q)


def test_matrix_round_trip(rotations):
    matrix = rotations.as_matrix()
    quat = m.matrix_to_quat(matrix)
    np.testing.assert_allclose(m.quat_to_matrix(quat), matrix, atol=1e-12)
    pose = m.matrix_to_pose(m.pose_to_matrix(np.concatenate([matrix[:, 0], quat], 1)))
    np.testing.assert_allclose(pose, np.concatenate([matrix[:, 0], quat], 1), atol=1e-12)


def test_multiply_rotate_conjugate(rotations):
    a, b = wxyz(rotations), wxyz(rotations)[::-1].copy()
    other = Rotation.from_quat(b[:, [1, 2, 3, 0]])
    product = m.quat_to_matrix(m.quat_multiply(a, b))
    np.testing.assert_allclose(product, (rotations * other).as_matrix(), atol=1e-12)
    vector = np.random.default_rng(0).normal(size=(len(a), 3))
    np.testing.assert_allclose(m.quat_rotate(a, vector), rotations.apply(vector), atol=1e-12)
    np.testing.assert_allclose(
        m.quat_rotate(m.quat_conjugate(a), m.quat_rotate(a, vector)), vector, atol=1e-12
    )


def test_rotation_vectors(rotations):
    quats = wxyz(rotations)
    expected = rotations.as_rotvec()
    half_turns = np.linalg.norm(expected, axis=1) > np.pi - 1e-6  # either sign
    for sign in (1.0, -1.0):
        found = m.quat_to_rotvec(sign * quats)
        np.testing.assert_allclose(found[~half_turns], expected[~half_turns], atol=1e-12)
        np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=1e-6)


def test_euler_is_intrinsic_xyz():
    angles = np.random.default_rng(2).uniform(-3, 3, (100, 3))
    expected = Rotation.from_euler("XYZ", angles).as_matrix()
    np.testing.assert_allclose(m.quat_to_matrix(m.euler_xyz_to_quat(angles)), expected, atol=1e-12)


def test_matrices_rotate_as_quaternions_do(rotations):
    quat, vector = wxyz(rotations), np.random.default_rng(1).standard_normal((len(rotations), 3))
    matrix = m.quat_to_matrix(quat)
    np.testing.assert_allclose(m.rotate(matrix, vector), m.quat_rotate(quat, vector), atol=1e-12)
    np.testing.assert_allclose(m.rotate_back(matrix, m.rotate(matrix, vector)), vector, atol=1e-12)


@pytest.mark.parametrize("bad", [[0.0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 0]])
def test_no_direction_is_refused(bad):
    with pytest.raises(ValueError, match="quaternion"):
        m.normalize_quat(np.array([[1.0, 0, 0, 0], bad]))


def test_what_is_not_turned_is_the_same_alone_and_beside_others():
    unturned = np.tile(np.eye(3), (4, 1, 1))
    beside = np.concatenate([unturned, np.diag([-1.0, -1.0, 1.0])[None]])
    alone, mixed = m.matrix_to_quat(unturned), m.matrix_to_quat(beside)
    assert alone.tobytes() == mixed[:4].tobytes()
    np.testing.assert_array_equal(alone, np.tile([1.0, 0, 0, 0], (4, 1)))
    np.testing.assert_allclose(np.abs(mixed[4]), [0, 0, 0, 1], atol=1e-15)
    assert m.matrix_to_quat(unturned.reshape(2, 2, 3, 3)).shape == (2, 2, 4)


def test_matrices_of_quaternions_do_not_depend_on_their_number() -> None:
    quat = np.random.default_rng(5).normal(size=(7, 3, 4))
    quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
    together = m.quat_to_matrix(quat)
    assert together.shape == (7, 3, 3, 3)
    for i, j in np.ndindex(7, 3):
        alone = m.quat_to_matrix(quat[i, j])
        assert np.ascontiguousarray(together[i, j]).tobytes() == alone.tobytes()
        w, x, y, z = quat[i, j]
        first = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
        np.testing.assert_allclose(alone[:, 0], first, atol=1e-14)


def test_look_at_has_the_target_in_the_middle_and_up_above():
    eye = np.array([[0.0, 0.0, 1.0], [2.0, 1.0, 0.5]])
    target = np.array([[1.0, 0.0, 1.0], [0.0, -1.0, 1.5]])
    axes = m.look_at(eye, target, np.array([[0.0, 0.0, 1.0]] * 2))
    np.testing.assert_allclose(axes[0], [[0, 0, -1], [-1, 0, 0], [0, 1, 0]], atol=1e-12)
    forward = (target[1] - eye[1]) / np.sqrt(9.0)
    np.testing.assert_allclose(axes[1, :, 2], -forward)
    assert axes[1, 2, 0] == 0.0 and axes[1, 2, 1] > 0.0  # its right is level, its up is upwards
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)


def test_look_at_straight_down_has_x_above():
    axes = m.look_at(np.array([0.0, 0.0, 2.0]), np.zeros(3), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(axes[:, 1], [1.0, 0.0, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="the eye is at the target"):
        m.look_at(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 1.0]))


WIDTHS = {
    "cross": (3, 3),
    "euler_xyz_to_quat": (3,),
    "look_at": (3, 3, 3),
    "matrix_to_pose": ((4, 4),),
    "matrix_to_quat": ((3, 3),),
    "norm": (3,),
    "normalize_quat": (4,),
    "pose_to_matrix": (7,),
    "quat_conjugate": (4,),
    "quat_multiply": (4, 4),
    "quat_rotate": (4, 3),
    "quat_to_matrix": (4,),
    "quat_to_rotvec": (4,),
    "quat_to_rpy": (4,),
    "rpy_to_quat": (3,),
    "rotate": ((3, 3), 3),
    "rotate_back": ((3, 3), 3),
    "rotvec_to_quat": (3,),
    "squares": (3,),
    "wrapped": (2,),
}


@pytest.mark.parametrize("name", m.__all__)
def test_every_function_takes_arrays_without_rows(name):
    widths = [(w,) if isinstance(w, int) else w for w in WIDTHS[name]]
    unit = [
        np.resize(np.eye(4).ravel(), w)[None] if len(w) < 2 else np.eye(w[0])[None] for w in widths
    ]
    one = [part + i if name == "look_at" else part for i, part in enumerate(unit)]
    shape = getattr(m, name)(*one).shape[1:]
    for lead in ((0,), (3, 0), (0, 3)):
        empty = [np.zeros((*lead, *w)) for w in widths]
        assert getattr(m, name)(*empty).shape == (*lead, *shape)


def test_roll_pitch_yaw_give_the_rotation_back_at_every_pitch():
    half = 0.5**0.5
    exact = [[half, 0, half, 0], [half, 0, -half, 0], [0.5, -0.5, 0.5, 0.5], [0.5, 0.5, -0.5, 0.5]]
    pitches = np.pi / 2 - np.array([0.0, 1e-9, 1e-6, 1e-3, 1.0, 2.0, 3.0])
    near = [
        Rotation.from_euler("xyz", [roll, sign * pitch, yaw]).as_quat(scalar_first=True)
        for roll in (-2.0, 0.0, 0.7)
        for sign in (1, -1)
        for pitch in pitches
        for yaw in (-1.0, 0.0, 3.0)
    ]
    quats = np.array([*exact, *near])
    angles = m.quat_to_rpy(quats)
    # scipy's lower-case axes are fixed: R = Rz Ry Rx.
    found = Rotation.from_euler("xyz", angles)
    apart = (found.inv() * Rotation.from_quat(quats, scalar_first=True)).magnitude()
    assert apart.max() < 1e-12
    assert np.abs(angles[:, 1]).max() <= np.pi / 2 + 1e-12
