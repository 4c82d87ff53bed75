"""The table of surfaces: whose colour counts, textures, and when it is computed again."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.drawing.looks import SurfaceTable, Unchanged
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

SCENE = """
<mujoco>
  <asset>
    <texture name="square" type="2d" builtin="flat" rgb1="1 0 0" width="4" height="4"/>
    <texture name="cube" type="cube" builtin="flat" rgb1="1 0 0" width="4" height="24"/>
    <material name="plain" rgba=".1 .2 .3 1" specular=".7" shininess=".6" emission=".5"/>
    <material name="square" texture="square" texrepeat="2 3" texuniform="true"/>
    <material name="cube" texture="cube"/>
  </asset>
  <worldbody>
    <geom type="box" size=".1 .2 .3" material="plain"/>
    <geom type="sphere" size=".4" material="plain" rgba=".9 .8 .7 1"/>
    <geom type="capsule" size=".1 .5" rgba=".2 .4 .6 .5"/>
    <geom type="plane" size="0 2 .1" material="square"/>
    <geom type="box" size=".1 .1 .1" material="cube"/>
  </worldbody>
</mujoco>
"""
LAYERS = np.array([[0, -1], [-1, 0]])


@pytest.fixture
def engine():
    return CpuEngine(mujoco.MjModel.from_xml_string(SCENE), 3)


@pytest.fixture
def surfaces(engine):
    surfaces = SurfaceTable(engine.model, LAYERS)
    surfaces.update(engine)
    return surfaces


def test_a_table_of_what_environments_share(surfaces):
    table = surfaces.table
    assert table.shape == (1, 5, 4, 4)
    scales = [[0.1, 0.2, 0.3, 0], [0.4, 0.4, 0.4, 0], [0.1, 0.1, 0.1, 0.5], [0, 2, 1, 0]]
    np.testing.assert_allclose(table[0, :4, 0], scales, atol=1e-6)
    # A material's colour, unless the geom has one of its own.
    np.testing.assert_allclose(table[0, 0, 1], [0.1, 0.2, 0.3, 1], atol=1e-6)
    np.testing.assert_allclose(table[0, 1, 1], [0.9, 0.8, 0.7, 1], atol=1e-6)
    np.testing.assert_allclose(table[0, 2, 1], [0.2, 0.4, 0.6, 0.5], atol=1e-6)
    # Specular, shininess, emission and the square; MuJoCo's values without a material.
    np.testing.assert_allclose(table[0, 1, 2], [0.7, 0.6, 0.5, -1], atol=1e-6)
    np.testing.assert_allclose(table[0, 2, 2], [0.5, 0.5, 0.0, -1], atol=1e-6)
    np.testing.assert_allclose(table[0, 3, 3], [2, 3, -1, 1], atol=1e-6)
    assert table[0, 3, 2, 3] == 0 and table[0, 4, 2, 3] == -1 and table[0, 4, 3, 2] == 0
    assert surfaces.textured.tolist() == [[False, False]] * 3 + [[True, False], [False, True]]
    assert surfaces.transparent.tolist() == [False, False, True, False, False]


def test_a_table_of_what_differs_between_environments(engine, surfaces):
    engine.write_model("geom_matid", 1, np.array([2]), np.array([0]))
    engine.write_model("geom_rgba", 0.25, np.array([1]), np.array([4 * 1 + 3]))
    surfaces.update(engine)
    assert surfaces.table.shape == (3, 5, 4, 4)
    assert surfaces.table[:, 0, 2, 3].tolist() == [-1, -1, 0]
    assert surfaces.textured[0].tolist() == [True, False]  # in any environment
    assert surfaces.table[:, 1, 1, 3].tolist() == [1, 0.25, 1]
    assert surfaces.transparent.tolist() == [False, True, True, False, False]


def test_a_table_is_computed_again_when_a_field_changes(engine, surfaces):
    before = surfaces.table
    surfaces.update(engine)
    assert surfaces.table is before
    engine.model.mat_rgba[0, 0] = 0.9
    surfaces.update(engine)
    assert surfaces.table[0, 0, 1, 0] == np.float32(0.9) and before[0, 0, 1, 0] == np.float32(0.1)


def test_arrays_are_compared_with_copies():
    unchanged, array = Unchanged(), np.zeros(3)
    assert not unchanged([array])
    assert unchanged([array])
    array[1] = 1.0
    assert not unchanged([array])
    assert not unchanged([array, array])
