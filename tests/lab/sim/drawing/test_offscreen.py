"""Which renderer draws, and that both draw the same; sizes in turn, memory, no OpenGL library."""

import ctypes
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.drawing.gl import VARIABLE
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.states import DataState, StoredStates
from embodichain.lab.sim.drawing.views import Optics, View, Viewpoint, view_of
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.utils.errors import ConfigError, RenderError

pytestmark = pytest.mark.slow

SCENE = """
<mujoco>
  <visual><global offwidth="160" offheight="120"/></visual>
  <worldbody>
    <light pos="0 0 3" dir="0 .3 -1" type="directional"/>
    <geom name="ground" type="plane" size="2 2 .1" rgba=".6 .6 .6 1"/>
    <geom name="box" type="box" size=".1 .2 .15" pos="-.5 0 .4" euler="20 30 0" rgba=".9 .1 .1 1"/>
    <body name="ball" pos=".3 .2 .4"><freejoint/>
      <geom name="ball" type="sphere" size=".2" rgba=".1 .2 .9 1"/></body>
    <camera name="front" pos="0 -2 1.2" xyaxes="1 0 0 0 .5 1" fovy="50"/>
  </worldbody>
</mujoco>
"""
AT = Viewpoint.look_at((0.3, -1.6, 1.4), (0.0, 0.0, 0.4))
BALL = 2


@pytest.fixture
def engine():
    engine = CpuEngine(mujoco.MjModel.from_xml_string(SCENE), 3)
    engine.write("qpos", [[0.3], [-0.2], [0.0]], None, slice(0, 1))
    size, color = engine.model_field("geom_size").copy(), engine.model_field("geom_rgba").copy()
    size[1, 3 * BALL] = 0.1
    color[2, 4 * BALL : 4 * BALL + 3] = 0.1, 0.8, 0.1
    engine.write_model("geom_size", size)
    engine.write_model("geom_rgba", color)
    return engine


@pytest.fixture(params=["layered", "classic"])
def renderer(request, engine, monkeypatch):
    monkeypatch.setenv(VARIABLE, request.param)
    renderer = OffscreenRenderer(engine.model)
    assert renderer.kind == request.param and "OpenGL" in renderer.about
    yield renderer
    renderer.close()
    renderer.close()


def lens(outputs=("color", "depth", "mask"), look="fast") -> View:
    return View(
        Optics(96, 64, (90.0, 80.0), (40.0, 30.0)), AT.position, AT.axes, None, outputs, look
    )


def test_both_renderers_draw_the_same(engine, monkeypatch):
    found = []
    for kind in ("layered", "classic"):
        monkeypatch.setenv(VARIABLE, kind)
        renderer = OffscreenRenderer(engine.model)
        found.append(renderer.draw(engine, [lens(), lens(("color",), "full")]))
        renderer.close()
    (fast, full), (classic, _) = found
    both = fast["mask"] == classic["mask"]
    assert both.mean() > 0.99
    error = np.abs(fast["depth"] - classic["depth"])
    assert error[both & (fast["mask"] < BALL)].max() < 2e-3
    assert np.median(error[both & (fast["mask"] == BALL)]) < 5e-3  # two different polyhedra
    assert not fast["depth"][fast["mask"] < 0].any()
    assert not classic["depth"][classic["mask"] < 0].any()
    for geom in (1, BALL):  # colours differ in shading only
        of = [p["color"][(p["mask"] == geom)].astype(float).mean(axis=0) for p in (fast, classic)]
        assert np.abs(of[0] - of[1]).max() < 40
        assert of[0].argmax() == of[1].argmax()
    assert full["color"].shape == (3, 64, 96, 4) and (full["color"][..., 3] == 255).all()
    assert set(full) == {"color"}


def test_each_environment_has_its_own_size_and_colour(engine, renderer):
    pictures = renderer.draw(engine, [lens()])[0]
    counts = [(mask == BALL).sum() for mask in pictures["mask"]]
    assert counts[1] < 0.4 * counts[0] and counts[2] > 0.7 * counts[0]
    seen = [pictures["color"][i][pictures["mask"][i] == BALL].mean(axis=0) for i in range(3)]
    assert [int(color[:3].argmax()) for color in seen] == [2, 2, 1]  # blue, blue, green
    again = renderer.draw(engine, [lens()], np.array([2, 0]))[0]
    for name, values in pictures.items():
        np.testing.assert_array_equal(again[name], values[[2, 0]])


def test_sizes_in_turn_keep_the_context(engine, renderer):
    """Larger than the scene's buffer too; pictures are those of before."""
    sizes = [(64, 48), (320, 240), (64, 48), (200, 480)]
    first = [renderer.pictures(engine, "front", size) for size in sizes]
    # Renderers of MuJoCo are expensive to make; that one is used again shows in nothing else.
    inside = renderer._renderer
    again = [renderer.pictures(engine, "front", size) for size in sizes]
    assert renderer._renderer is inside
    for (width, height), one, two in zip(sizes, first, again, strict=True):
        assert one.shape == (3, height, width, 3) and one.dtype == np.uint8 and one.std() > 5
        np.testing.assert_array_equal(one, two)


def test_two_scenes_are_drawn_in_turn(engine, renderer):
    other = mujoco.MjModel.from_xml_string(SCENE.replace(".6 .6 .6 1", ".1 .6 .1 1"))
    data = mujoco.MjData(other)
    mujoco.mj_forward(other, data)
    alone = renderer.pictures(engine, "front", (64, 48))
    second = OffscreenRenderer(other)
    green = second.pictures(DataState(data), "front", (64, 48))
    np.testing.assert_array_equal(renderer.pictures(engine, "front", (64, 48)), alone)
    np.testing.assert_array_equal(second.pictures(DataState(data), "front", (64, 48)), green)
    assert green[0, 40, 32].argmax() == 1
    second.close()
    np.testing.assert_array_equal(renderer.pictures(engine, "front", (64, 48)), alone)


def test_threads_of_a_process_draw_in_turn(engine, renderer):
    """Every thread gets its pictures, as if it were alone."""
    sizes = [(64, 48), (32, 24), (48, 48), (40, 16)]
    stored = StoredStates(engine.model)
    stored.append(engine, 1)
    alone = [renderer.pictures(stored, "front", size) for size in sizes]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(3):
            drawn = pool.map(lambda size: renderer.pictures(stored, "front", size), sizes)
            for expected, found in zip(alone, drawn, strict=True):
                np.testing.assert_array_equal(found, expected)


def test_a_camera_with_a_lens_of_its_own_in_each_environment(engine, renderer):
    """Twice the focal length shows the ball twice as large, around another centre."""
    engine.write_model("geom_size", engine.model.geom_size.reshape(1, -1))
    engine.write("qpos", [0.0, 0.2, 0.4], None, slice(0, 3))
    view = view_of(engine, Viewpoint.look_at((0.0, -2.0, 0.4), (0.0, 0.2, 0.4)), 96, 64)
    focal = np.array([[60.0, 60.0], [120.0, 60.0], [60.0, 60.0]])
    centre = np.array([[48.0, 32.0], [48.0, 32.0], [30.0, 40.0]])
    view = replace(view, focal=focal, centre=centre, outputs=("mask",))
    seen = [np.nonzero(mask == BALL) for mask in renderer.draw(engine, [view])[0]["mask"]]
    # A sphere of radius 0.2, 2.2 m away: 60 * 0.2 / sqrt(2.2^2 - 0.2^2) = 5.48 pixels around it.
    for (rows, columns), (fx, fy), (cx, cy) in zip(seen, focal, centre, strict=True):
        assert rows.mean() + 0.5 == pytest.approx(cy, abs=0.6)
        assert columns.mean() + 0.5 == pytest.approx(cx, abs=0.6)
        assert np.ptp(rows) + 1 == pytest.approx(2 * 5.48 * fy / 60.0, abs=1.1)
        assert np.ptp(columns) + 1 == pytest.approx(2 * 5.48 * fx / 60.0, abs=1.1)


def test_renderers_that_are_closed_leave_no_memory(engine, monkeypatch):
    """A context takes some 30 MB."""

    def used() -> int:
        with open("/proc/self/statm") as pages:
            return int(pages.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def draw_and_close(times: int) -> None:
        for _ in range(times):
            renderer = OffscreenRenderer(engine.model)
            renderer.pictures(engine, "front", (64, 48))
            renderer.close()

    for kind in ("layered", "classic"):
        monkeypatch.setenv(VARIABLE, kind)
        draw_and_close(3)
        before = used()
        draw_and_close(12)
        assert used() - before < 100e6


def test_stored_states_are_drawn_as_they_were(engine, renderer):
    stored = StoredStates(engine.model)
    for env in (0, 2, 1):
        stored.append(engine, env)
    live = renderer.draw(engine, [lens()])[0]
    alone = renderer.draw(DataState(engine.data_of(1)), [lens()])[0]
    cameras = [view_of(state, "front", 64, 48) for state in (stored, engine)]
    before = renderer.draw(engine, [cameras[1]])[0]["color"].copy()
    engine.write("qpos", 0.0, None, slice(0, 2))
    engine.write_model("geom_size", 0.1)
    later = renderer.draw(stored, [lens()])[0]
    for name, values in live.items():
        np.testing.assert_array_equal(later[name], values[[0, 2, 1]])
        np.testing.assert_array_equal(alone[name][0], values[1])
    np.testing.assert_array_equal(
        renderer.draw(stored, [cameras[0]])[0]["color"], before[[0, 2, 1]]
    )
    stored.clear()
    assert stored.num_envs == 0


def test_a_wrong_name_is_refused(engine, monkeypatch):
    monkeypatch.setenv(VARIABLE, "layerd")
    with pytest.raises(ConfigError, match=r"EMBODICHAIN_RENDERER: .*'layerd'; .*Did"):
        OffscreenRenderer(engine.model)


def test_rays_draw_depth_and_masks_only(engine, monkeypatch):
    found = []
    for kind in ("layered", "rays"):
        monkeypatch.setenv(VARIABLE, kind)
        renderer = OffscreenRenderer(engine.model)
        found.append(renderer.draw(engine, [lens(("depth", "mask"))])[0])
        if kind == "rays":
            with pytest.raises(RenderError, match="colours need OpenGL.*libegl1 .*libopengl0"):
                renderer.pictures(engine, "front", (64, 48))
        renderer.close()
    both = found[0]["mask"] == found[1]["mask"]
    assert both.mean() > 0.99
    flat = both & (found[0]["mask"] < BALL)
    assert np.abs(found[0]["depth"] - found[1]["depth"])[flat].max() < 2e-3


def test_egl_without_libopengl_is_one_error(engine, monkeypatch):
    """As on Debian with libegl1 and without libopengl0; MuJoCo itself links with neither."""

    def without_a_library(name):
        raise ctypes.ArgumentError("'NoneType' object has no attribute 'glGetError'")

    OffscreenRenderer(engine.model).close()  # PyOpenGL's platform is chosen before its import
    monkeypatch.setattr("OpenGL.GL.glGetString", without_a_library)
    monkeypatch.setenv(VARIABLE, "layered")
    with pytest.raises(RenderError, match=r"no picture can be made .*glGetError.* libopengl0"):
        OffscreenRenderer(engine.model)
    monkeypatch.setenv(VARIABLE, "classic")
    renderer = OffscreenRenderer(engine.model)
    assert renderer.about == "OpenGL"
    renderer.close()


@pytest.mark.parametrize("kind", ["", "layered", "classic"])
def test_without_a_driver_one_error_names_the_packages(tmp_path, kind):
    """EGL finds its drivers in a folder of JSON files; here it is empty."""
    script = f"""
import mujoco
from embodichain.lab.sim.drawing.gl import VARIABLE
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
engine = CpuEngine(mujoco.MjModel.from_xml_string({SCENE!r}), 1)
renderer = OffscreenRenderer(engine.model)
print(renderer.kind)
renderer.pictures(engine, "front", (64, 48))
"""
    none = {"__EGL_VENDOR_LIBRARY_DIRS": str(tmp_path), "MUJOCO_GL": "egl", VARIABLE: kind}
    command = [sys.executable, "-c", script]
    env = {**os.environ, **none}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    last = done.stderr.strip().splitlines()[-1]
    message = "no picture can be made here" if kind else "colours need OpenGL"
    assert done.returncode == 1 and f"RenderError: {message}" in last
    assert done.stdout == ("" if kind else "rays\n")
    assert "libegl1 libgl1-mesa-dri libopengl0" in last
    assert "ignored" not in done.stderr


@pytest.mark.unmeasured
def test_nothing_loads_opengl_until_something_draws():
    script = """
import sys
import embodichain
env = embodichain.make("cart_pole", num_envs=2)
env.reset()
env.step(env.action_space.sample())
loaded = [m for m in sys.modules if m.startswith(("OpenGL", "mujoco.egl"))]
drawing = [m for m in sys.modules if m.startswith("embodichain.lab.sim.drawing.")]
print(loaded, [m for m in drawing if m.rpartition(".")[2] not in ("views", "states")])
env.sim.render(width=16, height=16)
print("OpenGL" in sys.modules)
env.close()
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=240
    )
    assert done.stdout.splitlines()[-2:] == ["[] []", "True"]
