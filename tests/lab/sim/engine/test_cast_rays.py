"""`cast_rays` against `mj_ray`: chosen geoms, each environment's state and sizes, no trace."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

XML = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body pos="0 0 1"><freejoint/><geom name="ball" size=".1" group="3"/></body>
    <body pos="0 0 2"><geom name="box" type="box" size=".2 .2 .1" euler="20 0 0" group="2"/></body>
    <body pos="0 0 2.5"><geom name="unseen" size=".1" rgba="1 1 1 0"/></body>
  </worldbody>
</mujoco>
"""
FLOOR, BALL, BOX, UNSEEN = range(4)
DOWN = np.array([0.0, 0.0, -1.0])
START = np.array([0.0, 0.0, 3.0])
ALL = np.ones(4, np.bool_)


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(XML)


def only(*geoms: int):
    return np.isin(np.arange(4), geoms)


def test_rays_hit_the_chosen_geoms_alone_whatever_their_group(model):
    engine = CpuEngine(model, 2)
    for geoms, distance, hit in [
        (only(FLOOR, BALL), 1.9, BALL),
        (only(FLOOR), 3.0, FLOOR),
        (only(FLOOR, UNSEEN), 3.0, FLOOR),
        (only(UNSEEN), -1.0, -1),
        (only(), -1.0, -1),
    ]:
        found = engine.cast_rays(START, DOWN, geoms)
        np.testing.assert_allclose(found.distance, [[distance]] * 2, atol=1e-12)
        assert found.geom.tolist() == [[hit]] * 2 and found.normal is None


def test_distances_geoms_and_normals_are_those_of_mj_ray(model):
    engine = CpuEngine(model, 1)
    draw = np.random.default_rng(0)
    starts, rays = (
        START + draw.uniform(-0.5, 0.5, (400, 3)),
        DOWN + draw.uniform(-0.2, 0.2, (400, 3)),
    )
    found = engine.cast_rays(starts, rays, ALL, normal=True)
    data, geom, normal = engine.data_of(0), np.zeros(1, np.int32), np.zeros(3)
    for i in range(400):
        distance = mujoco.mj_ray(model, data, starts[i], rays[i], None, 1, -1, geom, normal)
        assert (found.distance[0, i], found.geom[0, i]) == (distance, geom[0])
        np.testing.assert_array_equal(found.normal[0, i], normal)
    assert set(found.geom[0]) == {FLOOR, BALL, BOX}


@pytest.mark.parametrize("persistent", [True, False])
def test_each_environment_has_its_own_state_and_model(model, persistent):
    engine = CpuEngine(model, 4, persistent=persistent)
    engine.write("qpos", [[0.5], [1.5]], np.array([1, 3]), np.array([2]))
    engine.write_model("geom_size", 0.3, np.array([2]), np.array([3 * BALL]))
    found = engine.cast_rays(START, DOWN, only(BALL))
    np.testing.assert_allclose(found.distance[:, 0], [1.9, 2.4, 1.7, 1.4], atol=1e-12)
    some = engine.cast_rays(START, DOWN, only(BALL), np.array([1, 2]))
    np.testing.assert_array_equal(some.distance, found.distance[1:3])


@pytest.mark.parametrize("persistent", [True, False])
def test_rays_leave_no_trace_in_the_simulation(model, persistent):
    plain, cast = (CpuEngine(model, 3, persistent=persistent) for _ in range(2))
    for engine in (plain, cast):
        engine.write("qvel", [[0.1], [0.2], [0.3]], None, np.array([0]))
    for _ in range(60):
        plain.step(5)
        cast.cast_rays(START, DOWN, only(BOX))
        cast.step(5)
    assert cast.rows.tobytes() == plain.rows.tobytes()
    assert cast.model_fields() == {} and cast.model.geom_group.tolist() == [0, 3, 2, 0]
    np.testing.assert_array_equal(cast.model_of(1).geom_group, [0, 3, 2, 0])
