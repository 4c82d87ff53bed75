"""One step of damped least squares, against matrix algebra and within bounds."""

import numpy as np
import pytest

from embodichain.lab.sim.solvers.least_squares import joint_step

COUNT = 40


def problem(rows: int, joints: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors (r, n), Jacobians (r, k, n) and changes in the null space (k, n)."""
    generator = np.random.default_rng(0)
    shapes = (rows, COUNT), (rows, joints, COUNT), (joints, COUNT)
    error, jacobian, posture = (generator.uniform(-1, 1, shape) for shape in shapes)
    return 0.3 * error, jacobian, posture


@pytest.mark.parametrize(("rows", "joints"), [(6, 6), (6, 7), (3, 6), (6, 1)])
def test_a_free_step_is_the_formula_of_matrices(rows, joints) -> None:
    error, jacobian, posture = problem(rows, joints)
    free = np.full((joints, COUNT), np.inf)
    plain = joint_step(error, jacobian, -free, free)
    leaning = joint_step(error, jacobian, -free, free, posture)
    for i in range(COUNT):
        e, j, v = error[:, i], jacobian[..., i], posture[:, i]
        damped = j @ j.T + (0.5 * e @ e + 1e-8) * np.eye(rows)
        np.testing.assert_allclose(plain[:, i], j.T @ np.linalg.solve(damped, e), atol=1e-12)
        expected = v + j.T @ np.linalg.solve(damped, e - j @ v)
        np.testing.assert_allclose(leaning[:, i], expected, atol=1e-12)


def test_joints_at_a_bound_are_compensated_for_by_the_others() -> None:
    error, jacobian, _ = problem(6, 7)
    bound = np.full((7, COUNT), np.inf)
    bound[2] = 0.0
    step = joint_step(error, jacobian, -bound, bound)
    others = np.delete(np.arange(7), 2)
    for i in range(COUNT):
        e, j = error[:, i], jacobian[:, others, i]
        damped = j @ j.T + (0.5 * e @ e + 1e-8) * np.eye(6)
        np.testing.assert_allclose(step[others, i], j.T @ np.linalg.solve(damped, e), atol=1e-12)
    assert not step[2].any()
    bound = np.full((7, COUNT), 0.05)
    assert (np.abs(joint_step(error, jacobian, -bound, bound)) <= bound).all()


def test_a_step_depends_neither_on_the_number_nor_on_the_place() -> None:
    error, jacobian, posture = problem(6, 6)
    bound = np.full((6, COUNT), 0.2)
    step = joint_step(error, jacobian, -bound, bound, posture)
    for rows in ([0], [7, 3], list(range(COUNT))[::-1], [5] * 300):
        alone = joint_step(*(part[..., rows] for part in (error, jacobian, -bound, bound, posture)))
        assert np.array_equal(alone, step[:, rows])
