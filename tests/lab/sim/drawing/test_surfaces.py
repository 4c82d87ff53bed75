"""Materials, textures, lights, transparency and shadows, against numbers worked out by hand and
against MuJoCo's own renderer."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.drawing.classic import ClassicRenderer
from embodichain.lab.sim.drawing.layered.batch_renderer import BatchRenderer
from embodichain.lab.sim.drawing.rays import RayRenderer
from embodichain.lab.sim.drawing.views import View, Viewpoint, view_of
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine

SIZE = 64
ABOVE = Viewpoint.look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 60.0)
ASIDE = Viewpoint.look_at((0.6, -2.5, 2.0), (0.0, 0.0, 0.3))
FLAT = '<headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/>'
"""A surface's colour is then its own."""


def scene(world: str, assets: str = "", headlight: str = FLAT) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><visual>{headlight}</visual><asset>{assets}</asset>"
        f"<worldbody>{world}</worldbody></mujoco>"
    )


def draw(renderer_class, state, viewpoint=ABOVE, look="fast", size=SIZE) -> np.ndarray:
    """(N, H, W, 3) float."""
    renderer = renderer_class(state.model)
    view = view_of(state, viewpoint, size, size, near=0.05, far=50.0, look=look)
    color = renderer.draw(state, [view])[0]["color"]
    renderer.close()
    return color[..., :3].astype(float)


def middle(pictures: np.ndarray) -> np.ndarray:
    return pictures[:, SIZE // 2, SIZE // 2]


CHECKER = """<texture name="t" type="2d" builtin="checker" rgb1=".1 .2 .3" rgb2=".7 .5 .9"
                      width="64" height="64"/>"""


@pytest.mark.parametrize(
    ("geom", "material"),
    [
        ('type="plane" size="0 0 .1"', 'texrepeat="1 1"'),
        ('type="plane" size="0 0 .1"', 'texrepeat="2 3" texuniform="true"'),
        ('type="plane" size="1 .6 .1"', 'texrepeat="2 3"'),
        ('type="plane" size="1 .6 .1"', 'texrepeat="2 3" texuniform="true"'),
        ('type="box" size="1 .6 .1"', 'texrepeat="2 1"'),
        ('type="sphere" size=".8"', 'texrepeat="2 3"'),
        ('type="cylinder" size=".8 .2"', 'texrepeat="2 3" texuniform="true"'),
    ],
)
def test_textures_lie_as_in_mujoco(geom, material):
    sky = '<texture type="skybox" builtin="flat" rgb1="0 0 0" rgb2="0 0 0" width="8" height="48"/>'
    assets = f'{CHECKER}{sky}<material name="m" texture="t" {material} specular="0"/>'
    engine = CpuEngine(scene(f'<geom {geom} material="m"/>', assets), 1)
    ours, mujocos = (draw(cls, engine) for cls in (BatchRenderer, ClassicRenderer))
    assert mujocos.std() > 10  # there is something to see
    assert np.abs(ours - mujocos).mean() < 2.5  # edges of the checker and of the shape


def test_a_sky_lies_as_in_mujoco():
    sky = """<texture type="skybox" builtin="gradient" rgb1="1 0 0" rgb2="0 0 1" width="64"
             height="384" mark="cross" markrgb="1 1 1"/>"""
    engine = CpuEngine(scene('<geom size=".01"/>', sky), 1)
    side = Viewpoint.look_at((0.0, 0.0, 0.0), (1.0, 0.6, 1.5), fovy=60.0)
    ours, mujocos = (draw(cls, engine, side) for cls in (BatchRenderer, ClassicRenderer))
    assert np.abs(ours - mujocos).mean() < 3.0


def test_every_environment_has_its_own_material_and_texture():
    colours = np.random.default_rng(0).integers(0, 256, (40, 3)) / 255.0
    assets = "".join(
        f'<texture name="t{i}" type="2d" builtin="flat" rgb1="{r} {g} {b}" width="4" height="4"/>'
        f'<material name="m{i}" texture="t{i}" rgba="1 1 1 1"/>'
        for i, (r, g, b) in enumerate(colours)
    )
    model = scene('<geom type="plane" size="1 1 .1" material="m0"/>', assets)
    engine = CpuEngine(model, 3)
    engine.write_model("geom_matid", 37, np.array([1]))
    roles = model.mat_texid.shape[1]
    engine.write_model("mat_texid", 21, np.array([2]), np.array([roles * 0 + 1]))
    found = middle(draw(BatchRenderer, engine))
    np.testing.assert_allclose(found, 255.0 * colours[[0, 37, 21]], atol=1.5)


def test_lights_are_those_of_each_environment():
    # The light shines straight down; the ground is grey 0.5; MuJoCo's rules of light are OpenGL's.
    model = scene(
        '<geom type="plane" size="3 3 .1" rgba=".6 .6 .6 1"/>'
        '<light pos="0 0 2" dir="0 0 -1" type="spot" cutoff="20" exponent="0" diffuse=".5 .4 .3"'
        ' specular="0 0 0" attenuation="1 .5 0" castshadow="false"/>',
        headlight='<headlight ambient=".2 .2 .2" diffuse="0 0 0" specular="0 0 0"/>',
    )
    engine = CpuEngine(model, 4)
    engine.write_model("light_active", 0, np.array([1]))
    engine.write_model("light_type", int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL), np.array([2]))
    engine.write_model("light_diffuse", 0.9, np.array([3]), np.array([0]))
    pictures = draw(BatchRenderer, engine)
    at_two_metres = 1.0 / (1.0 + 0.5 * 2.0)
    spot = np.array([0.5, 0.4, 0.3])
    light = [spot * at_two_metres, 0 * spot, spot, np.array([0.9, 0.4, 0.3]) * at_two_metres]
    np.testing.assert_allclose(middle(pictures), 255 * 0.6 * (0.2 + np.array(light)), atol=1.5)
    # 1.5 m aside is outside a cone of 20 degrees; parallel light is everywhere.
    aside = pictures[:, SIZE // 2, 4]
    np.testing.assert_allclose(aside[[0, 1, 3]], 255 * 0.6 * 0.2, atol=1.5)
    np.testing.assert_allclose(aside[2], middle(pictures)[2], atol=1.5)


def test_what_is_far_is_seen_through_what_is_near():
    model = scene(
        '<geom type="plane" size="5 5 .1" rgba="1 1 1 1"/>'
        '<body name="red" pos="0 0 1"><joint type="slide" axis="0 0 1"/>'
        '<geom type="box" size=".8 .8 .01" rgba="1 0 0 .5"/></body>'
        '<geom type="box" size=".8 .8 .01" pos="0 0 1" rgba="0 0 1 .25"/>'
    )
    engine = CpuEngine(model, 2)
    engine.write("qpos", [[0.5], [-0.5]])
    view = view_of(engine, ABOVE, SIZE, SIZE, outputs=("color", "mask"))
    renderer = BatchRenderer(model)
    for look in ("fast", "full"):
        pictures = renderer.draw(engine, [View(**{**vars(view), "look": look})])[0]
        white, red, blue = (np.array(c, float) for c in ([1, 1, 1], [1, 0, 0], [0, 0, 1]))
        red_near = 0.5 * red + 0.5 * (0.25 * blue + 0.75 * white)
        blue_near = 0.25 * blue + 0.75 * (0.5 * red + 0.5 * white)
        found = middle(pictures["color"][..., :3].astype(float)) / 255.0
        # In full look the sky adds a tenth to ambient light from above; it is cut off at white.
        np.testing.assert_allclose(found, [red_near, blue_near], atol=0.01)
        assert (middle(pictures["mask"]) == 0).all()  # depth and mask are of what is opaque
    renderer.close()


SHADOWS = """
  <light pos="0 0 3" dir="{direction}" type="{kind}" cutoff="60" exponent="0" diffuse=".7 .7 .7"/>
  <geom type="plane" size="3 3 .1" rgba=".8 .8 .8 1"/>
  <geom type="box" size=".2 .2 .05" pos="0 0 .8" rgba=".9 .3 .1 1"/>
"""


@pytest.mark.parametrize(
    ("kind", "direction", "low", "high"),
    [
        ("directional", ".5 0 -1", 0.2, 0.6),  # 0.8 m above the ground, so 0.4 m aside
        ("spot", "0 0 -1", -0.27, 0.27),  # 2.2 m below the light: 0.2 x 3 / 2.2
    ],
)
def test_shadows_fall_where_light_is_blocked(kind, direction, low, high):
    world = SHADOWS.format(kind=kind, direction=direction)
    head = '<headlight ambient=".2 .2 .2" diffuse="0 0 0" specular="0 0 0"/>'
    engine = CpuEngine(scene(world, headlight=head), 2)
    under = Viewpoint.look_at((0.0, -1.0, 0.5), (0.2, 0.0, 0.0), fovy=70.0)
    fast, full = (draw(BatchRenderer, engine, under, look, 200)[0] for look in ("fast", "full"))
    # The ground's points along y = 0 in pixels.
    x = np.linspace(-0.5, 0.9, 57)
    back = np.array([-0.2, -1.0, 0.5]) / np.linalg.norm([-0.2, -1.0, 0.5])
    right = np.cross([0, 0, 1], back) / np.linalg.norm(np.cross([0, 0, 1], back))
    gaps = np.stack([x, 0 * x, 0 * x], 1) - [0.0, -1.0, 0.5]
    focal = 100.0 / np.tan(np.radians(35.0))
    column = 100.0 + focal * (gaps @ right) / -(gaps @ back)
    row = 100.0 - focal * (gaps @ np.cross(back, right)) / -(gaps @ back)
    inside = (column > 0) & (column < 200) & (row > 0) & (row < 200)
    ratio = np.ones(len(x))
    at = row[inside].astype(int), column[inside].astype(int)
    ratio[inside] = full[at][:, 0] / np.maximum(fast[at][:, 0], 1.0)
    deep, lit = (x > low + 0.06) & (x < high - 0.06), (x < low - 0.06) | (x > high + 0.06)
    assert (deep & inside).sum() > 5 and (lit & inside).sum() > 5
    assert ratio[deep & inside].max() < 0.7
    assert ratio[lit & inside].min() > 0.9


def test_thin_parts_do_not_shade_themselves():
    world = """<light pos="0 0 3" dir=".6 .3 -1" type="directional"/>
        <geom type="plane" size="3 3 .1"/>
        <geom type="box" size="1 1 .001" pos="0 0 .001" rgba=".2 .8 .2 1"/>
        <geom type="box" size=".1 .1 .1" pos="1.5 1.5 .5"/>"""
    engine = CpuEngine(scene(world, headlight="<headlight specular='0 0 0'/>"), 1)
    for size in (48, 200):
        fast, full = (draw(BatchRenderer, engine, ABOVE, look, size) for look in ("fast", "full"))
        inside = slice(size // 4, 3 * size // 4)
        assert (full[0, inside, inside, 1] > 0.95 * fast[0, inside, inside, 1]).all()


def test_full_look_is_like_mujocos():
    world = SHADOWS.format(kind="directional", direction=".5 .2 -1")
    sky = """<texture type="skybox" builtin="gradient" rgb1=".6 .7 .8" rgb2=".2 .3 .4" width="64"
             height="384"/>"""
    engine = CpuEngine(scene(world, sky, headlight="<headlight specular='0 0 0'/>"), 1)
    ours, mujocos = (draw(c, engine, ASIDE, "full", 160) for c in (BatchRenderer, ClassicRenderer))
    assert np.abs(ours - mujocos).mean() < 8.0


def test_edges_are_smooth_in_full_look():
    sky = '<texture type="skybox" builtin="flat" rgb1="0 0 0" rgb2="0 0 0" width="8" height="48"/>'
    box = '<geom type="box" size=".7 .5 .1" euler="0 0 20" rgba=".8 .8 .8 1"/>'
    engine = CpuEngine(scene(box, sky), 1)
    fast, full = (draw(BatchRenderer, engine, look=look)[..., 0] for look in ("fast", "full"))
    assert set(np.unique(fast)) == {0, 204}
    assert {0, 224} < set(np.unique(full))  # light from above is a tenth brighter
    assert len(np.unique(full)) == 5  # 0 to 4 samples of a pixel
    assert full.mean() / 224 == pytest.approx(fast.mean() / 204, rel=0.02)


@pytest.mark.parametrize("light", ["", '<light type="directional" dir="0 0 -1"/>'])
def test_a_scene_without_anything_is_its_background(light):
    engine = CpuEngine(scene(light), 2)
    renderer = BatchRenderer(engine.model)
    for look in ("fast", "full"):
        view = view_of(engine, ABOVE, 16, 16, look=look, outputs=("color", "depth", "mask"))
        pictures = renderer.draw(engine, [view])[0]
        assert pictures["color"].min() > 100  # pale, not black
        assert (pictures["depth"] == 0).all() and (pictures["mask"] == -1).all()
    renderer.close()


@pytest.mark.parametrize("renderer_class", [BatchRenderer, ClassicRenderer, RayRenderer])
def test_what_light_passes_is_in_no_depth_and_no_mask(renderer_class):
    # From above, 3 m over the origin: a pane at 1 m, a pane of a material at 0.5 m, the floor's top
    # at 0.1 m. In the second environment the upper pane is opaque.
    world = """<geom name="floor" type="box" size="5 5 .1"/>
      <geom name="pane" type="box" size="2 2 .01" pos="0 0 1" rgba="1 0 0 .4"/>
      <geom name="tinted" type="box" size="2 2 .01" pos="0 0 .5" material="glass"/>"""
    model = scene(world, '<material name="glass" rgba="0 0 1 .5"/>')
    engine = CpuEngine(model, 2)
    pane = model.geom("pane").id
    engine.write_model("geom_rgba", 1.0, np.array([1]), np.array([4 * pane + 3]))
    renderer = renderer_class(model)
    size = SIZE, SIZE
    outputs = ("depth", "mask")
    view = view_of(engine, ABOVE, *size, near=0.05, far=50.0, outputs=outputs, look="fast")
    (found,) = renderer.draw(engine, [view])
    renderer.close()
    assert middle(found["mask"]).tolist() == [model.geom("floor").id, pane]
    assert middle(found["depth"]) == pytest.approx([2.9, 1.99], abs=2e-4)
