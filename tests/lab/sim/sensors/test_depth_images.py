"""Images computed from depth: a tilted plane, a step, a background, rays worked by hand."""

import numpy as np
import pytest

from embodichain.lab.sim.sensors.depth_images import (
    disparities,
    distances,
    normals,
    positions,
    slopes,
)

LENS = np.array([[10.0, 20.0, 3.0, 2.0]])
WIDTH, HEIGHT = 8, 6
EYE = np.array([[1.0, 2.0, 3.0]])
STRAIGHT = np.eye(3)[None]
"""Axes of a camera that looks down along -z, with x to the right."""


def plane(normal, offset):
    """(1, H, W) depth of the points p of a plane with normal . p = offset, in camera axes."""
    right, up = slopes(LENS, WIDTH, HEIGHT)
    ray = normal[0] * right + normal[1] * up - normal[2]
    return np.float32(offset / ray)


def test_slopes_go_through_the_middles_of_pixels():
    right, up = slopes(LENS, WIDTH, HEIGHT)
    assert right.shape == (1, 1, WIDTH) and up.shape == (1, HEIGHT, 1)
    assert right[0, 0, [0, 3]] == pytest.approx([-0.25, 0.05])  # (0.5 - 3) / 10, (3.5 - 3) / 10
    assert up[0, [0, 2], 0] == pytest.approx([0.075, -0.025])  # (2 - 0.5) / 20, (2 - 2.5) / 20


def test_a_lens_of_each_environment():
    lens = np.concatenate([LENS, LENS * 2])
    right, up = slopes(lens, WIDTH, HEIGHT)
    alone = slopes(lens[1:], WIDTH, HEIGHT)
    np.testing.assert_array_equal(right[1:], alone[0])
    np.testing.assert_array_equal(up[1:], alone[1])


def test_a_distance_is_the_length_of_the_ray():
    right, up = slopes(LENS, WIDTH, HEIGHT)
    depth = np.full((1, HEIGHT, WIDTH), 2.0, np.float32)
    points = positions(depth, right, up, np.zeros((1, 3)), STRAIGHT)
    np.testing.assert_allclose(
        distances(depth, right, up), np.linalg.norm(points, axis=-1), rtol=1e-6
    )


def test_positions_are_in_the_environments_frame():
    turned = np.array([[[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])  # looks along x
    right, up = slopes(LENS, WIDTH, HEIGHT)
    depth = np.full((1, HEIGHT, WIDTH), 2.0, np.float32)
    depth[0, 0, 0] = 0.0
    points = positions(depth, right, up, EYE, turned)
    assert points.dtype == np.float32
    assert points[0, 2, 3] == pytest.approx([3.0, 2.0 - 0.1, 3.0 - 0.05])
    assert points[0, 0, 0].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "normal", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, -0.6, 0.8), (0.48, 0.36, 0.8)]
)
def test_normals_of_a_plane_point_to_the_camera(normal):
    depth = plane(normal, -3.0)
    assert (depth > 0).all()
    right, up = slopes(LENS, WIDTH, HEIGHT)
    points = positions(depth, right, up, EYE, STRAIGHT)
    found = normals(depth, points, EYE)
    np.testing.assert_allclose(found[0], np.broadcast_to(normal, found[0].shape), atol=1e-4)


def test_a_step_of_depth_stays_sharp():
    depth = np.full((1, HEIGHT, WIDTH), 2.0, np.float32)
    depth[:, :, 4:] = 5.0
    right, up = slopes(LENS, WIDTH, HEIGHT)
    found = normals(depth, positions(depth, right, up, EYE, STRAIGHT), EYE)
    np.testing.assert_allclose(found[0], np.broadcast_to([0, 0, 1.0], found[0].shape), atol=1e-5)


def test_where_nothing_is_drawn():
    depth = np.zeros((1, HEIGHT, WIDTH), np.float32)
    depth[0, 2:4, 2:6] = 1.0
    right, up = slopes(LENS, WIDTH, HEIGHT)
    points = positions(depth, right, up, EYE, STRAIGHT)
    nothing = depth == 0
    assert (distances(depth, right, up)[nothing] == 0).all()
    assert (points[nothing] == 0).all()
    assert (normals(depth, points, EYE)[nothing] == 0).all()
    found = disparities(depth, LENS[:, 0], 0.3)
    assert (found[nothing] == 0).all()
    np.testing.assert_allclose(found[~nothing], 3.0)  # 10 px x 0.3 m / 1 m


def test_one_row_of_pixels_has_no_normal():
    depth = np.ones((1, 1, 4), np.float32)
    right, up = slopes(LENS, 4, 1)
    found = normals(depth, positions(depth, right, up, EYE, STRAIGHT), EYE)
    assert (found == 0).all()
