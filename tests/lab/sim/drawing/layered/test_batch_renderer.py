"""Depth and mask against MuJoCo's rays; each environment's own sizes, poses and colours."""

import dataclasses
import hashlib
import os
import resource
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from embodichain.lab.sim.drawing.layered.batch_renderer import BatchRenderer
from embodichain.lab.sim.drawing.views import Optics, View
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.utils.errors import RenderError

pytestmark = pytest.mark.slow

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


@pytest.mark.unmeasured
def test_pictures_of_another_process_are_the_same(engine, renderer, tmp_path):
    state = tmp_path / "qpos.npy"
    np.save(state, engine.state("qpos"))
    found = _digests(engine, renderer, 3)
    code = f"""
import sys; sys.path.insert(0, {os.fspath(Path(__file__).parent)!r})
from test_batch_renderer import *
from test_batch_renderer import _digests
engine = CpuEngine(mujoco.MjModel.from_xml_string(SCENE), 1)
engine.write("qpos", np.load({os.fspath(state)!r})[3:4])
print(*_digests(engine, BatchRenderer(engine.model), 0))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == found


def _digests(engine, renderer, env: int) -> list[str]:
    views = [dataclasses.replace(VIEW, look=look) for look in ("fast", "full")]
    pictures = renderer.draw(engine, views, np.array([env]))
    return [hashlib.sha256(p[name].tobytes()).hexdigest() for p in pictures for name in sorted(p)]


def test_more_pictures_than_one_target_has_layers(engine, renderer):
    small = dataclasses.replace(VIEW, optics=Optics(8, 6, (7.5, 7.0), (4.0, 3.0), 0.01, 20.0))
    envs = np.arange(renderer.context.max_layers // 2 + 7) % 4
    two = renderer.draw(engine, [small, small], envs)
    four = renderer.draw(engine, [small])[0]
    for pictures in two:
        for name, picture in pictures.items():
            np.testing.assert_array_equal(picture, four[name][envs])


@pytest.mark.parametrize(
    ("size", "look", "count", "message"),
    [
        (10_000, "fast", 10_000, r"10000 environments \(10000 x 10000\) take \d+.\d GiB"),
        (10_000, "full", 1, "10000 x 10000 is too large: the most in full look"),
        (40_000, "fast", 1, "40000 x 40000 is too large"),
    ],
)
def test_what_memory_has_no_room_for_is_refused(engine, renderer, size, look, count, message):
    optics = Optics(size, size, (1e4, 1e4), (size / 2, size / 2))
    view = dataclasses.replace(VIEW, optics=optics, look=look)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RenderError, match=message):
        renderer.draw(engine, [view], np.zeros(count, np.int64))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**16  # KiB


@pytest.mark.unmeasured
def test_renderers_that_are_closed_leave_no_memory():
    code = f"""
import sys; sys.path.insert(0, {os.fspath(Path(__file__).parent)!r})
from test_batch_renderer import *
engine = CpuEngine(mujoco.MjModel.from_xml_string(SCENE), 2)
def use():
    renderer = BatchRenderer(engine.model)
    for look in ("fast", "full"):
        renderer.draw(engine, [dataclasses.replace(VIEW, look=look)])
    renderer.close()
def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096
for _ in range(4): use()
before = resident()
for _ in range(8): use()
print(resident() - before)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(run.stdout) < 8 * 2**20  # one renderer takes more


SHAPES = """
<mujoco>
  <asset>
    <mesh name="cube" vertex="{vertices}" face="{faces}"/>
    <hfield name="hills" nrow="20" ncol="30" size="1.5 1 .3 .1" elevation="{heights}"/>
  </asset>
  <worldbody>
    <geom type="hfield" hfield="hills"/>
    <geom type="mesh" mesh="cube" pos="0 -.2 .7" euler="20 30 10"/>
  </worldbody>
</mujoco>
"""


def test_meshes_keep_their_shape_in_small_pictures_and_fields_their_hills():
    cube = trimesh.creation.box((0.5, 0.4, 0.3)).subdivide().subdivide().subdivide().subdivide()
    assert len(cube.faces) > 3000
    y, x = np.mgrid[0:20, 0:30]
    numbers = [cube.vertices, cube.faces, 0.5 + 0.5 * np.sin(x / 3) * np.cos(y / 4)]
    texts = [" ".join(map(str, np.ravel(n))) for n in numbers]
    model = mujoco.MjModel.from_xml_string(
        SHAPES.format(vertices=texts[0], faces=texts[1], heights=texts[2])
    )
    engine = CpuEngine(model, 1)
    renderer = BatchRenderer(model)
    pictures = renderer.draw(engine, [VIEW])[0]
    renderer.close()
    depth, mask = by_rays(engine, 0)
    same = pictures["mask"][0] == mask
    assert same.mean() > 0.98 and set(np.unique(mask)) == {-1, 0, 1}
    error = np.abs(pictures["depth"][0] - depth)[same & (mask >= 0)]
    assert np.quantile(error, 0.99) < 0.005
    # Three faces are in view: each has one colour, and edges between them are sharp.
    colours, counts = np.unique(
        pictures["color"][0][pictures["mask"][0] == 1], axis=0, return_counts=True
    )
    assert np.sort(counts)[-3:].sum() > 0.95 * counts.sum()


def test_what_is_not_drawn_is_said_once(caplog):
    cloth = """<mujoco><worldbody><body name="b"><flexcomp name="cloth" type="grid" dim="2"
        count="3 3 1" spacing=".1 .1 .1" radius=".01"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(cloth)
    for _ in range(2):
        BatchRenderer(model).close()
    assert [r.getMessage() for r in caplog.records] == ["flexes are not drawn: cloth"]
