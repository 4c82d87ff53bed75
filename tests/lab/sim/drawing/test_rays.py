"""Depth and masks by rays against a wall and a post that are placed by hand."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.drawing.rays import RayRenderer
from embodichain.lab.sim.drawing.states import StoredStates
from embodichain.lab.sim.drawing.views import Optics, View, Viewpoint
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.utils.errors import RenderError

SCENE = """
<mujoco>
  <worldbody>
    <body pos="1.6 0 0"><joint type="slide" axis="1 0 0"/>
      <geom name="wall" type="box" size=".1 4 4"/></body>
    <geom name="post" type="box" size=".05 .1 4" pos="1.25 .4 0"/>
    <geom name="hidden" type="box" size=".05 4 4" pos=".5 0 0" group="3"/>
    <geom name="unseen" type="box" size=".05 4 4" pos=".6 0 0" rgba="1 1 1 0"/>
  </worldbody>
</mujoco>
"""
WALL, POST = 3, 0  # geoms of the world come first
AHEAD = Viewpoint.look_at((0, 0, 0), (1, 0, 0))  # the world's y is on the left
LENS = Optics(40, 30, (40.0, 30.0), (16.0, 12.0))
BOTH = ("depth", "mask")


@pytest.fixture
def engine():
    return CpuEngine(mujoco.MjModel.from_xml_string(SCENE), 3)


def see(optics=LENS, outputs=BOTH, **kwargs):
    return View(optics, AHEAD.position, AHEAD.axes, outputs=outputs, **kwargs)


def draw(engine, *views, envs=None):
    return RayRenderer(engine.model).draw(engine, views, envs)


def test_a_wall_is_as_deep_everywhere_as_it_stands(engine):
    pictures = draw(engine, see())[0]
    assert pictures["depth"].shape == pictures["mask"].shape == (3, 30, 40)
    assert pictures["depth"].dtype == np.float32 and pictures["mask"].dtype == np.int32
    wall = pictures["mask"] == WALL
    assert wall.mean() > 0.7 and set(np.unique(pictures["mask"])) == {WALL, POST}
    # depth is along the axis: it does not grow with the angle
    np.testing.assert_allclose(pictures["depth"][wall], 1.5, atol=1e-6)


def test_edges_land_on_their_pixels(engine):
    """The post's face is 1.2 m away, 0.3 to 0.5 m to the left: 0.25 to 0.4167 of its depth."""
    pictures = draw(engine, see())[0]
    # The face: from 16 - 40 x 0.4167 = -0.67 to 16 - 40 x 0.25 = 6. The ray through pixel 6, of
    # slope (16 - 6.5) / 40, meets the side of the post, which is 0.3 m to the left.
    row = pictures["mask"][0, 0]
    assert row.tolist() == [POST] * 7 + [WALL] * 33
    np.testing.assert_allclose(pictures["depth"][0, :, :6], 1.2, atol=1e-6)
    np.testing.assert_allclose(pictures["depth"][0, :, 6], 0.3 * 40 / 9.5, atol=1e-6)
    # a camera with its axis elsewhere: the picture moves with it, upwards too
    moved = draw(engine, see(Optics(40, 30, (40.0, 30.0), (20.0, 12.0))))[0]["mask"][0, 0]
    assert moved.tolist() == [WALL] * 3 + [POST] * 8 + [WALL] * 29


def test_each_environment_has_its_own_state_and_lens(engine):
    engine.write("qpos", [[0.0], [0.5], [1.0]])
    focal = np.array([[40.0, 30.0], [40.0, 30.0], [80.0, 30.0]])
    pictures = draw(engine, see(focal=focal))[0]
    np.testing.assert_allclose(pictures["depth"][:, 15, 20], [1.5, 2.0, 2.5], atol=1e-6)
    edges = (pictures["mask"][:, 0] == POST).sum(axis=1)
    assert edges.tolist() == [7, 7, 0]  # 16 - 80 x 0.3 / 1.3 = -2.5: out of the picture
    some = draw(engine, see(focal=focal), see(), envs=np.array([2, 1]))
    for name in BOTH:
        np.testing.assert_array_equal(some[0][name], pictures[name][[2, 1]])


def test_near_and_far_cut(engine):
    far = Optics(40, 30, (40.0, 30.0), (16.0, 12.0), near=0.1, far=1.4)
    pictures = draw(engine, see(far))[0]
    assert set(np.unique(pictures["mask"])) == {-1, POST}
    assert (pictures["depth"][pictures["mask"] == -1] == 0).all()
    near = Optics(40, 30, (40.0, 30.0), (16.0, 12.0), near=1.4)  # beyond the post's back
    pictures = draw(engine, see(near))[0]
    assert set(np.unique(pictures["mask"])) == {WALL}
    np.testing.assert_allclose(pictures["depth"], 1.5, atol=1e-6)


def test_many_environments_are_drawn_in_parts(engine, monkeypatch):
    engine.write("qpos", [[0.0], [0.5], [1.0]])
    whole = draw(engine, see(outputs=("depth",)))[0]
    assert set(whole) == {"depth"}
    # As with pictures of millions of pixels, which are cast in parts.
    monkeypatch.setattr("embodichain.lab.sim.drawing.rays._RAYS_AT_ONCE", 2 * 40 * 30)
    np.testing.assert_array_equal(draw(engine, see())[0]["depth"], whole["depth"])


def test_colours_and_stored_states_need_opengl(engine):
    with pytest.raises(RenderError, match="colours need OpenGL, and rays draw here"):
        draw(engine, see(outputs=("color", "depth")))
    stored = StoredStates(engine.model)
    stored.append(engine)
    with pytest.raises(RenderError, match="stored states need OpenGL"):
        RayRenderer(engine.model).draw(stored, [see()])
