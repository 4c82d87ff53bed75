"""Depth and mask against MuJoCo's rays; each environment's own sizes, poses and colours."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.drawing.batch_renderer import BatchRenderer
from embodichain.lab.sim.drawing.views import Optics, View
from embodichain.lab.sim.engine.cpu import CpuEngine

SCENE = """
<mujoco>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1" type="directional"/>
    <geom name="ground" type="plane" size="5 5 .1" rgba=".6 .6 .6 1"/>
    <geom name="box" type="box" size=".1 .2 .15" pos="-.5 0 .4" euler="20 30 0"/>
    <geom name="ball" type="sphere" size=".2" pos="0 .3 .3"/>
    <geom name="pill" type="capsule" size=".08 .2" pos=".4 -.3 .4" euler="0 60 0"/>
    <geom name="can" type="cylinder" size=".12 .2" pos="0 -.4 .3" euler="40 0 0"/>
    <geom name="egg" type="ellipsoid" size=".1 .2 .3" pos=".5 .3 .4"/>
    <geom name="hidden" type="box" size=".3 .3 .3" pos="0 0 .3" group="3"/>
    <body name="cube" pos="0 0 .8"><freejoint/><geom name="cube" type="box" size=".1 .1 .1"/></body>
  </worldbody>
</mujoco>
"""
WIDTH, HEIGHT = 96, 64
EYE = np.array([0.3, -1.6, 1.4])


def turned(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(1, 3, 3) axes of a camera that looks at a target: right, up, backwards."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)[None]


OPTICS = Optics(WIDTH, HEIGHT, (90.0, 80.0), (50.0, 30.0), 0.01, 20.0)
VIEW = View(OPTICS, EYE[None], turned(EYE, np.array([0, 0, 0.4])), None, ("color", "depth", "mask"))


@pytest.fixture(scope="module")
def engine():
    engine = CpuEngine(mujoco.MjModel.from_xml_string(SCENE), 4)
    draw = np.random.default_rng(0)
    engine.write("qpos", draw.uniform(-0.3, 0.3, (4, 2)), None, np.arange(2))
    return engine


@pytest.fixture(scope="module")
def renderer(engine):
    renderer = BatchRenderer(engine.model)
    yield renderer
    renderer.close()


def by_rays(engine, env: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) depth along the axis and geom id of every pixel's centre."""
    x = (np.arange(WIDTH) + 0.5 - OPTICS.centre[0]) / OPTICS.focal[0]
    y = -(np.arange(HEIGHT) + 0.5 - OPTICS.centre[1]) / OPTICS.focal[1]
    local = np.stack([*np.meshgrid(x, y), -np.ones((HEIGHT, WIDTH))], axis=-1).reshape(-1, 3)
    ray = local @ VIEW.axes[0].T
    length = np.linalg.norm(ray, axis=1)
    distance, geom = np.zeros(len(ray)), np.zeros(len(ray), np.int32)
    groups = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    data, unit = engine.data_of(env), (ray / length[:, None]).reshape(-1)
    mujoco.mj_multiRay(
        engine.model, data, EYE, unit, groups, 1, -1, geom, distance, None, len(ray), 1e9
    )
    return (distance / length).reshape(HEIGHT, WIDTH), geom.reshape(HEIGHT, WIDTH)


def test_depth_and_mask_are_those_of_rays(engine, renderer):
    pictures = renderer.draw(engine, [VIEW])[0]
    for env in range(4):
        depth, mask = by_rays(engine, env)
        same = pictures["mask"][env] == mask
        assert same.mean() > 0.985  # the rest are pixels on edges, and round shapes are polygons
        hit = same & (mask >= 0)
        error = np.abs(pictures["depth"][env] - depth)[hit]
        assert np.median(error) < 1e-5
        assert np.quantile(error, 0.99) < 0.01
    assert set(np.unique(pictures["mask"])) == {-1, 0, 1, 2, 3, 4, 5, 7}


def test_a_picture_depends_on_its_environment_alone(engine, renderer):
    together = renderer.draw(engine, [VIEW, VIEW])
    for env in (2, 0):
        alone = renderer.draw(engine, [VIEW], np.array([env]))[0]
        for name, picture in alone.items():
            np.testing.assert_array_equal(picture[0], together[0][name][env])
            np.testing.assert_array_equal(picture[0], together[1][name][env])


@pytest.mark.parametrize(
    ("field", "geom", "value"),
    [("geom_size", 2, 0.25), ("geom_rgba", 1, 0.9), ("geom_pos", 3, 0.6)],
)
def test_a_field_of_one_environment_changes_its_picture_alone(engine, renderer, field, geom, value):
    width = engine.model_values(field).shape[-1]
    before = renderer.draw(engine, [VIEW])[0]["color"]
    columns = np.array([geom * width])
    was = engine.model_field(field)[3, columns].copy()
    engine.write_model(field, value, np.array([3]), columns)
    after = renderer.draw(engine, [VIEW])[0]["color"]
    engine.write_model(field, was, np.array([3]), columns)
    np.testing.assert_array_equal(before[:3], after[:3])
    assert (before[3] != after[3]).any()
