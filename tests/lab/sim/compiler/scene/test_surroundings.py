"""What a scene looks like: ground, sky, lights, table and pedestal."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.gym.envs import BaseEnv, EnvCfg
from embodichain.lab.sim.cfg import RigidObjectCfg, RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler.scene.appearance import wood
from embodichain.lab.sim.configs.scene_cfg import (
    FlatPatchCfg,
    GroundCfg,
    LightCfg,
    PedestalCfg,
    SceneCfg,
    SkyCfg,
    TableCfg,
    TerrainCfg,
    ViewCfg,
)
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.recording.format.container.archive import load_mjz, scene_archive
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import HOME, UR10

DOWN = {"top": ViewCfg(eye=[0.25, 0.25, 1.0], target=[0.25, 0.25, 0], up=[0, 1, 0], fovy=20)}


def built(scene, *lights, **fields):
    """A simulation with a scene and a ball of 10 cm that begins 30 cm above the ground."""
    sim = SimulationManager(SimulationManagerCfg(headless=True, scene=scene, **fields))
    ball = RigidObjectCfg(uid="ball", shape=SphereCfg(radius=0.1), init_pos=[2, 2, 0.3])
    sim.add_rigid_object(ball)
    for light in lights:
        sim.add_light(light)
    return sim


def middle(sim):
    """The mean colour of the ground in the view `DOWN`."""
    return sim.render(camera="top", width=32, height=24).reshape(-1, 3).mean(axis=0)


# -- ground and sky --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["checker", "grid", "wood", "plain"])
def test_things_rest_on_the_ground_whatever_it_looks_like(kind):
    sim = built(SceneCfg(ground=GroundCfg(type=kind, size=1.0)))
    sim.update(step=300)  # the ball is outside of what is drawn
    assert sim.get_rigid_object("ball").read_pose()[0][0, 2] == pytest.approx(0.1, abs=2e-3)


@pytest.mark.parametrize("scene", [SceneCfg(ground=GroundCfg(type="none")), None])
def test_without_a_ground_things_fall(scene):
    fields = {"ground_plane": scene is not None}
    sim = built(scene or SceneCfg(ground=GroundCfg()), **fields)
    sim.update(step=300)
    assert sim.get_rigid_object("ball").read_pose()[0][0, 2] < -5
    assert "default_plane" not in sim.asset_uids


def test_colours_are_drawn():
    def color(**ground):
        sim = built(SceneCfg(ground=GroundCfg(**ground)), views=DOWN)
        return middle(sim)

    red, green = color(type="plain", colors=[[1, 0, 0]]), color(type="plain", colors=[[0, 1, 0]])
    assert red[0] > 2 * max(red[1:]) and green[1] > 2 * max(green[0], green[2])
    # From above, [0.25, 0.25] is the middle of a tile of half a metre; its neighbour is green.
    tile = color(type="checker", colors=[[1, 0, 0], [0, 1, 0]], tile=0.5)
    assert abs(tile[0] - tile[1]) > 60
    planks = color(type="wood")
    assert planks[0] > planks[1] > planks[2] > 0  # brown


def test_a_grid_has_lines_between_its_tiles_and_finer_ones_inside():
    """From above, a picture of 24 cm around a corner of four tiles of half a metre."""
    view = ViewCfg(eye=[0.25, 0.25, 1.0], target=[0.25, 0.25, 0], up=[0, 1, 0], fovy=13.7)
    ground = GroundCfg(type="grid", colors=[[0.8, 0.8, 0.8], [0.2, 0.2, 0.2]], tile=0.5)
    sim = built(SceneCfg(ground=ground), views={"corner": view})
    picture = sim.render(camera="corner", width=240, height=240)[..., 0].astype(int)
    tile = np.median(picture)
    column = picture[:, 150]  # a row's line crosses it in the middle, fine ones 10 cm beside
    assert tile - column[110:131].min() > 60
    fine = tile - column[10:31].min()
    assert 20 < fine < tile - column[110:131].min()
    assert abs(column[50:90] - tile).max() < 5


@pytest.mark.parametrize("terrain", [None, TerrainCfg(patches={"a": FlatPatchCfg()}, levels=1)])
@pytest.mark.parametrize(
    ("kind", "period"), [("checker", 1.0), ("grid", 0.5), ("wood", 0.5)], ids=str
)
def test_a_tile_is_as_large_as_it_says(kind, period, terrain):
    """A picture of 2 m from above is the same a period further, and differs half a period on."""
    view = ViewCfg(eye=[0, 0, 10], target=[0, 0, 0], up=[0, 1, 0], fovy=np.degrees(0.2))
    ground = GroundCfg(type=kind, tile=0.5, colors=[[0.8, 0.8, 0.8], [0.2, 0.2, 0.2]])
    scene = SceneCfg(ground=ground, terrain=terrain, lights={}, sun=0.0, headlight=0.0, ambient=1)
    sim = built(scene, views={"above": view})
    line = sim.render(camera="above", width=200, height=200)[..., 0].astype(float)
    pixels = round(100 * period)

    def change(shift):
        return np.abs(line[:, shift:] - line[:, :-shift]).mean()

    assert change(pixels) < 0.35 * change(pixels // 2)


def test_less_sun_makes_shadows_softer():
    def contrast(sun):
        sim = built(SceneCfg(ground=GroundCfg(type="plain"), sun=sun))
        view = sim.scene.model.light("default").diffuse
        return float(view.sum())

    assert contrast(None) == contrast(1.0) == pytest.approx(2 * contrast(0.5))
    assert contrast(0.0) == 0.0


def test_the_sky_is_a_gradient():
    scene = SceneCfg(sky=SkyCfg(top=[1, 0, 0], horizon=[0, 0, 1]), ground=GroundCfg(type="none"))
    views = {
        "up": ViewCfg(eye=[0, 0, 1], target=[0, 0, 2], fovy=20),
        "ahead": ViewCfg(eye=[0, 0, 1], target=[1, 0, 1], fovy=5),
    }
    sim = built(scene, views=views)
    up, ahead = (sim.render(camera=c, width=16, height=12).mean(axis=(0, 1)) for c in views)
    assert up[0] > up[2] + 50 and ahead[0] - ahead[2] < up[0] - up[2] - 50


def test_wood_is_seamless_and_always_the_same():
    for planks in (True, False):
        shade = wood(planks)
        np.testing.assert_array_equal(shade, wood(planks))
        assert shade.min() >= 0 and shade.max() <= 1 and 0.05 < shade.std() < 0.3
        # Neighbouring columns are as alike across the edge as inside.
        inside = np.abs(np.diff(shade, axis=1)).mean()
        assert np.abs(shade[:, 0] - shade[:, -1]).mean() < 2 * inside
    assert np.abs(np.diff(wood(False), axis=0)).mean() > 3 * inside  # grain runs along x


def test_an_archive_keeps_the_wood():
    sim = built(SceneCfg(ground=GroundCfg(type="wood"), table=None))
    model = load_mjz(scene_archive(sim.scene.spec))
    assert model.ntexdata == sim.scene.model.ntexdata
    np.testing.assert_array_equal(model.tex_data, sim.scene.model.tex_data)


# -- lights ----------------------------------------------------------------------------------------


def test_kinds_of_lights():
    lights = [
        LightCfg(uid="sun", light_type="directional", direction=[0, 0, -1], intensity=15),
        LightCfg(uid="dim", light_type="directional", shadow=False),
        LightCfg(uid="lamp", light_type="spot", init_pos=[0, 0, 2], cutoff=30, color=[1, 0, 0]),
        LightCfg(uid="bulb", init_pos=[1, 0, 2]),
    ]
    sim = built(SceneCfg(), *lights)
    model = sim.scene.model
    assert [model.light(i).name for i in range(model.nlight)] == ["sun", "dim", "lamp", "bulb"]
    kind = mujoco.mjtLightType
    assert model.light_type.tolist() == [
        int(k)
        for k in (
            kind.mjLIGHT_DIRECTIONAL,
            kind.mjLIGHT_DIRECTIONAL,
            kind.mjLIGHT_SPOT,
            kind.mjLIGHT_POINT,
        )
    ]
    assert model.light_castshadow.tolist() == [True, False, True, False]
    assert model.light("lamp").cutoff == 30
    np.testing.assert_allclose(model.light("sun").diffuse, [0.5, 0.5, 0.5])
    np.testing.assert_allclose(model.light("lamp").diffuse, [1, 0, 0])
    # Shadow maps cover the surroundings of a directional light: it stands above the ball.
    np.testing.assert_allclose(model.light("sun").pos[:2], [2, 2], atol=0.2)
    np.testing.assert_allclose(model.light("lamp").pos, [0, 0, 2])


def test_a_scene_without_lights_has_a_sun():
    model = built(SceneCfg()).scene.model
    assert [model.light(i).name for i in range(model.nlight)] == ["default"]


def test_ambient_light_brightens():
    means = []
    for level in (0.1, 0.6):
        sim = built(SceneCfg(ambient=level, headlight=0.0), views=DOWN)
        means.append(middle(sim).mean())
    assert means[1] > means[0] + 40


# -- furniture -------------------------------------------------------------------------------------


def task(scene, base=None, **fields):
    """An environment with a scene and, if `base` is given, a UR10 at this position."""
    robot = None
    if base is not None:
        robot = RobotCfg(uid="ur10", fpath=UR10, init_pos=base, init_qpos=HOME)
    return BaseEnv(EnvCfg(robot=robot, scene=SceneCfg(**scene), **fields))


@pytest.mark.parametrize("kind", ["wood", "plain"])
def test_a_cube_rests_on_the_table(kind):
    table = TableCfg(size=[1.0, 0.6, 0.7], pos=[0.5, 0.2, 0.1], type=kind)
    cube = RigidObjectCfg(shape=CubeCfg(size=[0.1, 0.1, 0.1]), init_pos=[0.9, 0.4, 1.0])
    env = task({"table": table}, objects={"cube": cube})
    env.sim.update(step=200)
    assert env.sim.get_rigid_object("cube").read_pose()[0][0, 2] == pytest.approx(0.85, abs=2e-3)
    pose = env.sim.get_rigid_object("table").read_pose()[0][0]
    np.testing.assert_allclose(pose, [0.5, 0.2, 0.78])  # the middle of a top of 4 cm
    model = env.sim.scene.model
    legs = [g for g in range(model.ngeom) if model.geom(g).name.startswith("table/leg")]
    data = env.sim.engine.data_of(0)
    np.testing.assert_allclose(data.geom_xpos[legs, 2] - model.geom_size[legs, 2], 0.1)
    np.testing.assert_allclose(data.geom_xpos[legs, 2] + model.geom_size[legs, 2], 0.76)
    with pytest.raises(ValueError, match="table has 5 shapes"):
        env.sim.get_rigid_object("table").set_body_scale([[2, 2, 2]])
    env.close()


def test_a_pedestal_fits_below_the_robot():
    env = task({"pedestal": PedestalCfg()}, base=[0.3, -0.2, 0.8])
    pedestal = env.sim.scene.model.geom("pedestal/geom")
    np.testing.assert_allclose(pedestal.size, [0.1, 0.4, 0])
    np.testing.assert_allclose(env.sim.engine.data_of(0).geom_xpos[pedestal.id], [0.3, -0.2, 0.4])
    assert pedestal.contype == 1
    env.close()
    env = task(
        {"pedestal": PedestalCfg(shape="box", pos=[0, 0, 0.2], size=[0.4, 0.2, 0.3])},
        base=[0, 0, 0.5],
        sim_cfg=SimulationManagerCfg(headless=True),
    )
    pedestal = env.sim.scene.model.geom("pedestal/geom")
    np.testing.assert_allclose(pedestal.size, [0.2, 0.1, 0.15])
    np.testing.assert_allclose(env.sim.engine.data_of(0).geom_xpos[pedestal.id], [0, 0, 0.35])
    env.close()


def test_furniture_that_collides_with_nothing():
    table, pedestal = TableCfg(collision=False), PedestalCfg(collision=False)
    env = task({"table": table, "pedestal": pedestal}, base=[0, 0, 1])
    model = env.sim.scene.model
    own = [g for g in range(model.ngeom) if model.geom(g).name.startswith(("table/", "pedestal/"))]
    assert len(own) == 6 and not model.geom_contype[own].any()
    env.close()


WRONG = {
    "on the ground": (PedestalCfg(), [0, 0, 0], "scene.pedestal.size: missing value: the robot"),
    "an oval": (
        PedestalCfg(size=[0.2, 0.3, 1]),
        [0, 0, 1],
        "scene.pedestal.size: a cylinder is as wide as long",
    ),
    "no robot": (PedestalCfg(), None, "scene.pedestal.pos: missing value: the task has no robot"),
}


@pytest.mark.parametrize(("pedestal", "base", "says"), WRONG.values(), ids=WRONG)
def test_wrong_pedestals_are_refused(pedestal, base, says):
    with pytest.raises(ConfigError) as caught:
        task({"pedestal": pedestal}, base=base)
    assert any(str(problem).startswith(says) for problem in caught.value.problems)


def test_terms_name_furniture_and_uids_are_unique():
    pair = {"from": {"uid": "table"}, "to": {"uid": "pedestal"}}
    from embodichain.lab.gym.envs.cfg import MetricCfg

    metrics = {"apart": MetricCfg(func="distance", params=pair)}
    scene = {"table": TableCfg(pos=[1, 0, 0]), "pedestal": PedestalCfg()}
    env = task(scene, base=[0, 0, 1], metrics=metrics)
    env.reset()
    info = env.step(np.zeros((1, 6), np.float32))[-1]
    # From the middle of the top, 73 cm high, to that of the pedestal, 50 cm high.
    assert float(info["metrics"]["apart"][0]) == pytest.approx(np.hypot(1, 0.23), abs=1e-6)
    env.close()
    with pytest.raises(ConfigError, match=r"objects\.table: uid 'table' is taken by scene\.table"):
        task({"table": TableCfg()}, objects={"table": RigidObjectCfg()})
