"""Lights as numbers, and what lights that cast shadows see."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.drawing.layered.lighting import (
    casters,
    light_table,
    positional,
    shadow_views,
)
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

SCENE = """
<mujoco>
  <visual><headlight ambient=".1 .1 .1"/></visual>
  <worldbody>
    <light type="directional" dir="0 0 -2" diffuse=".5 .5 .5" ambient=".2 0 0" castshadow="true"/>
    <light type="spot" pos="1 0 3" dir="0 0 -1" cutoff="60" exponent="7" castshadow="true"
           attenuation="1 2 3" specular=".3 .3 .3"/>
    <light type="point" pos="0 1 2" castshadow="true"/>
    <geom type="box" size=".1 .2 .3" pos="1.5 0 .5"/>
    <geom type="sphere" size=".2" pos="-1 1 .8"/>
  </worldbody>
</mujoco>
"""
ROWS = np.array([1, 0])


@pytest.fixture
def engine():
    return CpuEngine(mujoco.MjModel.from_xml_string(SCENE), 2)


def test_lights_of_environments_as_numbers(engine):
    engine.write_model("light_active", 0, np.array([1]), np.array([0]))
    table = light_table(engine, ROWS, np.array([5, 6]))
    assert table.shape == (2, 16, 4)
    # Ambient light of the headlight and of lights that are on; the row of surfaces.
    np.testing.assert_allclose(table[:, 0], [[0.1, 0.1, 0.1, 5], [0.3, 0.1, 0.1, 6]], atol=1e-6)
    sun, spot, point = (table[:, 1 + 5 * i : 6 + 5 * i] for i in range(3))
    np.testing.assert_allclose(sun[1, 0], [0, 0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(sun[:, 1, 0], [0.0, 0.5])
    np.testing.assert_allclose(spot[0, 0], [0, 0, -1, 1], atol=1e-6)
    np.testing.assert_allclose(spot[0, 2, :3], 0.3, atol=1e-6)
    np.testing.assert_allclose(spot[0, 3], [1, 0, 3, 0.5], atol=1e-6)  # cos(60 deg)
    np.testing.assert_allclose(spot[0, 4], [1, 2, 3, 7], atol=1e-6)
    np.testing.assert_allclose(point[0, 3], [0, 1, 2, -1], atol=1e-6)


def test_parallel_light_and_spots_cast_shadows(engine):
    assert casters(engine) == (0, 1) and positional(engine)
    engine.write_model("light_castshadow", 0, None, np.array([1]))
    assert casters(engine) == (0,)
    engine.write_model("light_active", 0, np.array([0]), np.array([0]))
    assert casters(engine) == (0,)  # it is on in the other environment
    engine.write_model("light_active", 0, None, np.array([0]))
    assert casters(engine) == ()


def test_scenes_without_lights_have_ambient_light_only():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
    )
    engine = CpuEngine(model, 2)
    assert light_table(engine, ROWS, ROWS).shape == (2, 1, 4)
    assert casters(engine) == () and not positional(engine)


def test_shadow_maps_are_as_tight_as_bounding_spheres(engine):
    geoms = np.arange(2)
    views = shadow_views(engine, ROWS, (0, 1), geoms).astype(float)
    assert views.shape == (2, 2, 4, 4)
    centres, reach = engine.derived("geom_xpos")[0], engine.model.geom_rbound
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = (centres[:, None] + reach[:, None, None] * directions).reshape(-1, 3)
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    sun = homogeneous @ views[0, 0].T
    assert (sun[:, 3] == 1).all()
    np.testing.assert_allclose(sun[:, :3].max(axis=0), 1.0, atol=0.05)
    np.testing.assert_allclose(sun[:, :2].min(axis=0), -1.0, atol=0.05)
    assert sun[:, 2].min() == pytest.approx(0.0, abs=0.05)
    # Down the spot's axis, near things have smaller depths; 60 deg aside is the map's edge.
    spot = views[0, 1]
    depths = []
    for height in (0.8, 0.5, 0.2):
        clip = spot @ [1.0, 0.0, height, 1.0]
        np.testing.assert_allclose(clip[:2], 0.0, atol=1e-5)
        depths.append(clip[2] / clip[3])
    assert 0.0 <= depths[0] < depths[1] < depths[2] <= 1.0
    edge = spot @ [1.0 + np.tan(np.radians(60.0)), 0.0, 2.0, 1.0]
    assert np.abs(edge[:2] / edge[3]).max() == pytest.approx(1.0, abs=1e-4)
