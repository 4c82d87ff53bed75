"""Pixels, depths and rays of cameras, worked out by hand."""

import numpy as np
import pytest

from embodichain.lab.sim.drawing.layered.projections import view_table
from embodichain.lab.sim.drawing.views import Optics, View

# At (1, 2, 3), looking along +y: right is +x, up is +z, backwards is -y.
AXES = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])[None]
EYE = np.array([[1.0, 2.0, 3.0]])
OPTICS = Optics(200, 100, (80.0, 120.0), (90.0, 60.0), 0.1, 10.0)


def pixel(table: np.ndarray, point: np.ndarray) -> tuple[float, float, float]:
    """Column and row, and depth from 0 to 1, of a point."""
    x, y, z, w = table[:4].astype(float) @ np.append(point, 1.0)
    return 100.0 * (1.0 + x / w), 50.0 * (1.0 + y / w), z / w


@pytest.mark.parametrize(
    ("aside", "above", "away"), [(0.0, 0.0, 1.0), (0.5, 0.25, 2.0), (-1.0, -0.3, 4.0)]
)
def test_a_point_is_at_its_pixel(aside, above, away):
    table = view_table([View(OPTICS, EYE, AXES)], np.zeros(1, np.int64))[0, 0]
    column, row, _ = pixel(table, EYE[0] + [aside, away, above])
    # Columns grow to the right and rows downwards, from the top left corner.
    assert column == pytest.approx(90.0 + 80.0 * aside / away, abs=1e-3)
    assert row == pytest.approx(60.0 - 120.0 * above / away, abs=1e-3)


def test_depth_is_one_at_near_and_zero_at_far_and_gives_metres():
    table = view_table([View(OPTICS, EYE, AXES)], np.zeros(1, np.int64))[0, 0]
    for away in (0.1, 0.5, 3.0, 10.0):
        _, _, depth = pixel(table, EYE[0] + [0.2, away, 0.1])
        assert 1.0 / (table[8, 0] + depth * table[8, 1]) == pytest.approx(away, rel=1e-4)
    assert pixel(table, EYE[0] + [0, 0.1, 0])[2] == pytest.approx(1.0, abs=1e-5)
    assert pixel(table, EYE[0] + [0, 10.0, 0])[2] == pytest.approx(0.0, abs=1e-5)


def test_rays_go_through_their_pixels():
    table = view_table([View(OPTICS, EYE, AXES)], np.zeros(1, np.int64))[0, 0].astype(float)
    np.testing.assert_allclose(table[4, :3], EYE[0])
    for column, row in ((0.0, 0.0), (200.0, 0.0), (50.0, 75.0)):
        ray = table[5, :3] + column / 200 * table[6, :3] + row / 100 * table[7, :3]
        assert ray[1] == pytest.approx(1.0)  # one metre along the axis
        found = pixel(table, EYE[0] + 2.5 * ray)
        assert found[:2] == pytest.approx((column, row), abs=1e-3)
    np.testing.assert_allclose(table[5:8, 3], AXES[0, :, 2])


def test_environments_have_their_own_pose_and_lens():
    eyes = np.arange(9.0).reshape(3, 3)
    focal = np.array([[80.0, 80.0], [40.0, 40.0], [20.0, 20.0]])
    view = View(OPTICS, eyes, AXES, focal)
    shared = View(OPTICS, EYE, AXES)
    tables = view_table([view, shared], np.array([2, 0]))
    assert tables.shape == (2, 2, 9, 4)
    np.testing.assert_allclose(tables[0, :, 4], [[6, 7, 8, 0], [0, 1, 2, 1]])
    np.testing.assert_allclose(tables[1, :, 4], [[1, 2, 3, 0], [1, 2, 3, 1]])
    columns = [
        pixel(tables[0, row], eyes[env] + [1.0, 2.0, 0.0])[0] for row, env in ((0, 2), (1, 0))
    ]
    assert columns == pytest.approx([90 + 20 * 0.5, 90 + 80 * 0.5], abs=1e-3)
