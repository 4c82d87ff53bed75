"""Range finders and height scans against distances that are worked out by hand."""

import numpy as np
import pytest

from embodichain.lab.sim.cfg import RigidObjectCfg, RobotCfg
from embodichain.lab.sim.sensors import (
    HeightScanSensorCfg,
    LinksCfg,
    RayFanCfg,
    RayGridCfg,
    RayPatternCfg,
    RaySensorCfg,
)
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.sensors.conftest import cube

AHEAD = RayPatternCfg(directions=[(1, 0, 0)])
QUARTER = np.sqrt(0.5)
YAWED = (QUARTER, 0.0, 0.0, QUARTER)  # a quarter turn about z: x points along the world's y


def box(uid, size, pos, **kwargs):
    return RigidObjectCfg(
        uid=uid, shape=CubeCfg(size=size), body_type="static", init_pos=pos, **kwargs
    )


def wall(distance=1.5):
    """Its face is `distance` ahead of the origin, along x."""
    return box("wall", [0.2, 8.0, 8.0], (distance + 0.1, 0, 0))


def mount(**kwargs):
    """A small cube, 1 m up, that the sensor is fixed on."""
    return cube("cube", **{"pos": (0, 0, 1), "body_type": "kinematic", **kwargs})


def ray(pattern=AHEAD, on="cube", **kwargs):
    return RaySensorCfg(uid="ray", of=LinksCfg(uid=on), pattern=pattern, **kwargs)


def scan(size=(1.0, 0.0), **kwargs):
    grid = RayPatternCfg(grid=RayGridCfg(size=size, resolution=0.5))
    kwargs = {"of": LinksCfg(uid="cube"), "pattern": grid, **kwargs}
    return HeightScanSensorCfg(uid="scan", **kwargs)


# -- distances -------------------------------------------------------------------------------------


def test_a_wall_is_as_far_as_it_stands_and_further_at_an_angle(scene):
    fan = RayFanCfg(horizontal_range=(-np.pi / 3, np.pi / 3), horizontal_count=3)
    sim = scene([mount(), wall()], [ray(RayPatternCfg(fan=fan))])
    sensor = sim.get_sensor("ray")
    # straight ahead 1.5 m, at 60 degrees 1.5 / cos 60
    np.testing.assert_allclose(sensor.read_distance(), [[3.0, 1.5, 3.0]] * 3, atol=1e-9)
    hits = [[1.5, -1.5 * np.sqrt(3), 1], [1.5, 0, 1], [1.5, 1.5 * np.sqrt(3), 1]]
    np.testing.assert_allclose(sensor.read_position(), [hits] * 3, atol=1e-9)
    data = sensor.get_data()
    assert tuple(data) == ("distance",) and data["distance"].shape == (3, 3)
    assert sensor.num_rays == 3


def test_normals_are_those_of_the_surface(scene):
    pattern = RayPatternCfg(directions=[(1, 0.5, 0), (0, 0, -2.0), (0, 0, 1)])
    sim = scene([mount(), wall()], [ray(pattern, data_types=["normal", "distance"])])
    sensor = sim.get_sensor("ray")
    normals = [[-1, 0, 0], [0, 0, 1], [0, 0, 0]]
    np.testing.assert_allclose(sensor.read_normal(), [normals] * 3, atol=1e-12)
    # the length of a direction does not matter: the ground is 1 m below
    np.testing.assert_allclose(sensor.read_distance()[:, 1], 1.0, atol=1e-12)
    assert tuple(sensor.get_data()) == ("normal", "distance")


def test_normals_that_are_not_measured_are_refused(scene):
    sim = scene([mount(), wall()], [ray()])
    with pytest.raises(ValueError, match="add normal to data_types"):
        sim.get_sensor("ray").read_normal()


def test_the_sensor_has_a_pose_on_its_link(scene):
    turned = ray(pos=(0.25, 0.0, 0.0), quat=(QUARTER, 0.0, -QUARTER, 0.0))  # x points up
    sim = scene([mount(), box("ceiling", [1, 1, 0.2], (0, 0, 2.6))], [turned])
    np.testing.assert_allclose(sim.get_sensor("ray").read_position(), [[[0.25, 0, 2.5]]] * 3)


def test_a_fixed_sensor_needs_no_entity(scene):
    fixed = RaySensorCfg(uid="ray", pattern=AHEAD, pos=(0.5, 0, 1))
    sim = scene([wall()], [fixed])
    np.testing.assert_allclose(sim.get_sensor("ray").read_distance(), [[1.0]] * 3, atol=1e-9)


def test_a_moved_or_resized_environment_alone_changes(scene):
    sim = scene([mount(), wall()], [ray()])
    sensor, carrier = sim.get_sensor("ray"), sim.get_rigid_object("cube")
    sensor.read_distance()
    pose = carrier.get_local_pose()
    pose[1, 0] = 0.5
    carrier.set_local_pose(pose)
    np.testing.assert_allclose(sensor.read_distance()[:, 0], [1.5, 1.0, 1.5], atol=1e-6)


@pytest.mark.parametrize(
    ("alignment", "quat", "hit"),
    [
        # pitched down by 45 degrees: the ray meets the floor 1 m ahead
        ("base", (np.cos(np.pi / 8), 0, np.sin(np.pi / 8), 0), [1, 0, 0]),
        ("yaw", (np.cos(np.pi / 8), 0, np.sin(np.pi / 8), 0), [1.5, 0, 1]),
        ("yaw", YAWED, [0, 2.5, 1]),
        ("world", YAWED, [1.5, 0, 1]),
    ],
)
def test_rays_turn_with_the_link_with_its_heading_or_not(scene, alignment, quat, hit):
    walls = [wall(), box("side", [8.0, 0.2, 8.0], (0, 2.6, 0))]
    sim = scene([mount(init_quat=quat), *walls], [ray(alignment=alignment)])
    np.testing.assert_allclose(sim.get_sensor("ray").read_position(), [[hit]] * 3, atol=1e-9)


@pytest.mark.parametrize(
    ("no_hit", "distance", "point"),
    [("max", 1.2, [1.2, 0, 1]), ("zero", 0.0, [0, 0, 1]), ("inf", np.inf, [np.inf] * 3)],
)
def test_what_a_ray_that_hits_nothing_reads(scene, no_hit, distance, point):
    sim = scene([mount(), wall()], [ray(max_range=1.2, no_hit=no_hit)])  # the wall is too far
    sensor = sim.get_sensor("ray")
    np.testing.assert_array_equal(sensor.read_distance(), [[distance]] * 3)
    np.testing.assert_allclose(sensor.read_position(), [[point]] * 3, atol=1e-12)


# -- what is hit -----------------------------------------------------------------------------------

ROBOT = """
<mujoco>
  <worldbody>
    <body name="base">
      <geom type="box" size=".1 .1 .1" mass="1"/>
      <body name="arm" pos=".5 0 0">
        <joint name="j" axis="0 0 1" range="-1 1"/>
        <geom type="box" size=".05 .05 .05" mass="1"/>
        <geom type="box" size=".06 .06 .06" group="3"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT)
    return RobotCfg(uid="robot", fpath=str(path), init_pos=(0, 0, 1))


@pytest.mark.parametrize(
    ("keys", "distance"),
    [
        ({}, 1.0),  # through the robot's own arm, to the cube
        ({"exclude": []}, 0.1),  # the inner face of its own base
        ({"exclude": ["robot", "cube"]}, 1.5),
        ({"exclude": ["cube"], "geom_groups": [3]}, 0.44),  # the arm's collision geom
        ({"hit": ["wall"]}, 1.5),
        ({"hit": ["wall", "robot"]}, 0.1),
        ({"hit": ["default_plane"]}, 10.0),
    ],
)
def test_a_sensor_chooses_what_its_rays_hit(scene, robot, keys, distance):
    between = cube("cube", pos=(1.05, 0, 1), body_type="static")
    sim = scene([between, wall()], [ray(on="robot", **keys)], robots=[robot])
    sensor = sim.get_sensor("ray")
    assert sensor.names == ("base",)  # the root
    np.testing.assert_allclose(sensor.read_distance(), [[distance]] * 3, atol=1e-9)


# -- heights ---------------------------------------------------------------------------------------


def ramp(degrees=20.0):
    """A slope that rises along x and goes through the origin; its box is 1 m thick."""
    angle = np.radians(degrees)
    # The box is turned about y; its upper face passes through the origin.
    down = 0.5 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    quat = (np.cos(angle / 2), 0.0, -np.sin(angle / 2), 0.0)
    return box("ramp", [6.0, 6.0, 1.0], tuple(down), init_quat=quat), np.tan(angle)


def test_a_height_scan_over_a_ramp(scene):
    slope, rise = ramp()
    sim = scene([mount(pos=(0.2, 0, 1)), slope], [scan()], ground_plane=False)
    # The grid is at x = -0.3, 0.2 and 0.7 m; the ramp is x tan 20 high there, the sensor 1 m.
    wanted = [[1.0 - x * rise for x in (-0.3, 0.2, 0.7)]] * 3
    np.testing.assert_allclose(sim.get_sensor("scan").read_height(), wanted, atol=1e-9)


def test_a_height_scan_turns_with_the_heading_alone(scene):
    slope, rise = ramp()
    about_x = np.array([np.cos(0.2), np.sin(0.2), 0.0, 0.0])  # rolled, then yawed by 90 degrees
    w, x = about_x[:2]
    quat = tuple(QUARTER * np.array([w, x, x, w]))
    carrier = mount(pos=(0.2, 0, 1), init_quat=quat)
    sim = scene([carrier, slope], [scan(size=(0.0, 1.0), pos=(0, 0.1, 0))], ground_plane=False)
    # Its y axis, and the offset along it, point along the world's -x.
    wanted = [[1.0 - x * rise for x in (0.6, 0.1, -0.4)]] * 3
    np.testing.assert_allclose(sim.get_sensor("scan").read_height(), wanted, atol=1e-9)


@pytest.mark.parametrize(("no_hit", "empty"), [("max", 2.5 - 1.0), ("zero", 0.0), ("inf", np.inf)])
def test_a_height_scan_beyond_an_edge_and_beside_a_step(scene, no_hit, empty):
    ground = box("table", [1.0, 1.0, 1.0], (0, 0, 0))
    step = box("step", [0.4, 1.0, 1.0], (-0.7, 0, 0.8))
    carrier = mount(pos=(0.1, 0, 0.8))
    sensors = [scan(max_range=2.5, no_hit=no_hit)]
    sim = scene([carrier, ground, step], sensors, ground_plane=False)
    # at x = -0.4 m the table 0.3 m below, at 0.1 m too, at 0.6 m nothing
    heights = sim.get_sensor("scan").read_height()
    np.testing.assert_allclose(heights, [[0.3, 0.3, empty]] * 3, atol=1e-9)
    pose = sim.get_rigid_object("cube").get_local_pose()
    pose[:, 0] = -0.2
    sim.get_rigid_object("cube").set_local_pose(pose)
    # at x = -0.7 m the step, whose top at 1.3 m is above the sensor
    np.testing.assert_allclose(sim.get_sensor("scan").read_height()[:, 0], -0.5, atol=1e-6)


# -- patterns --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pattern", "count"),
    [
        (RayPatternCfg(grid=RayGridCfg(size=(1.6, 1.0), resolution=0.1)), 17 * 11),
        (RayPatternCfg(grid=RayGridCfg(size=(0.0, 0.0), resolution=0.1)), 1),
        (RayPatternCfg(grid=RayGridCfg(size=(0.25, 0.0), resolution=0.1)), 3),
        (RayPatternCfg(fan=RayFanCfg(horizontal_count=8)), 8),
        (RayPatternCfg(fan=RayFanCfg(vertical_range=(-0.2, 0.2), vertical_count=4)), 144),
        (RayPatternCfg(directions=[(1, 0, 0), (0, 1, 0)]), 2),
    ],
)
def test_a_pattern_has_so_many_rays(scene, pattern, count):
    sensor = scene([mount()], [ray(pattern)]).get_sensor("ray")
    assert sensor.num_rays == count and sensor.read_distance().shape == (3, count)


def test_a_full_turn_has_no_direction_twice(scene):
    fan = RayFanCfg(horizontal_count=4)
    around = [box("front", [2, 2, 2], (3, 0, 1)), box("left", [2, 2, 2], (0, 4, 1))]
    sensor = scene([mount(), *around], [ray(RayPatternCfg(fan=fan))]).get_sensor("ray")
    # azimuths -180, -90, 0 and 90 degrees
    np.testing.assert_allclose(sensor.read_distance(), [[10.0, 10.0, 2.0, 3.0]] * 3, atol=1e-9)


def test_a_grid_starts_at_its_lowest_corner_and_runs_along_x(scene):
    grid = RayGridCfg(size=(1.0, 0.5), resolution=0.5)
    sensor = scene([mount()], [ray(RayPatternCfg(grid=grid))]).get_sensor("ray")
    wanted = [[x, y, 0] for y in (-0.25, 0.25) for x in (-0.5, 0, 0.5)]
    np.testing.assert_allclose(sensor.read_position()[0], wanted, atol=1e-12)


# -- mistakes --------------------------------------------------------------------------------------


def grid(**kwargs):
    return RayPatternCfg(grid=RayGridCfg(**{"size": (1, 1), "resolution": 0.1, **kwargs}))


@pytest.mark.parametrize(
    ("cfg", "path", "match"),
    [
        (ray(RayPatternCfg()), "pattern", "give one of grid, fan, directions; got none"),
        (ray(RayPatternCfg(directions=[(1, 0, 0)], fan=RayFanCfg())), "pattern", "got fan, dir"),
        (ray(RayPatternCfg(directions=[])), "pattern.directions", "names no ray"),
        (ray(RayPatternCfg(directions=[(0, 0, 0)])), "pattern.directions.0", "must not be zero"),
        (ray(grid(resolution=0.0)), "pattern.grid.resolution", "must be positive"),
        (ray(grid(size=(-1, 1))), "pattern.grid.size", "must not be negative"),
        (ray(grid(direction=(0, 0, 0))), "pattern.grid.direction", "must not be zero"),
        (ray(grid(size=(100, 100))), "pattern", "1002001 rays; a sensor can have 100000"),
        (
            ray(RayPatternCfg(fan=RayFanCfg(horizontal_range=(1, -1)))),
            "pattern.fan.horizontal_range",
            "lowest, highest",
        ),
        (
            ray(RayPatternCfg(fan=RayFanCfg(vertical_count=0))),
            "pattern.fan.vertical_count",
            "at least 1",
        ),
        (ray(on="cub"), "of.uid", "there are: cube, lamp"),
        (ray(pos=(0, 0)), "pos", "expected 3 values"),
        (ray(quat=(0, 0, 0, 0)), "quat", "must not be zero"),
        (ray(max_range=float("inf")), "max_range", "positive and finite, metres"),
        (ray(no_hit="inf", observe=True), "no_hit", "observations must be finite"),
        (ray(no_hit="far"), "no_hit", "one of 'max', 'inf', 'zero'"),
        (ray(alignment="link"), "alignment", "one of 'base', 'yaw', 'world'"),
        (ray(hit=["cub"]), "hit.0", "no entity is called 'cub'; there are: cube, lamp, default_p"),
        (ray(hit=[]), "hit", "names no entity"),
        (ray(exclude=["plane"]), "exclude.0", "no entity is called 'plane'"),
        (ray(geom_groups=[6]), "geom_groups", "numbers from 0 to 5"),
        (ray(data_types=[]), "data_types", "names no reading"),
        (scan(pattern=AHEAD), "pattern", "a height scan has a grid"),
        (scan(start_height=-1.0), "start_height", "must not be negative"),
    ],
)
def test_a_wrong_sensor_is_refused_with_what_is_allowed(scene, cfg, path, match):
    with pytest.raises(ConfigError, match=match) as error:
        scene([mount(), cube("lamp", pos=(3, 0, 1))], [cfg])
    assert [p.path for p in error.value.problems] == [f"{cfg.uid}.{path}"]


# -- rate ------------------------------------------------------------------------------------------


def counting(sim):
    """The environments of each call of the engine's `cast_rays`."""
    engine = sim.engine
    cast, asked = engine.cast_rays, []

    def counted(origins, directions, geoms, env_ids=None, **kwargs):
        asked.append(None if env_ids is None else env_ids.tolist())
        return cast(origins, directions, geoms, env_ids, **kwargs)

    vars(engine)["cast_rays"] = counted
    return asked


def test_a_rate_casts_rays_of_due_environments_only(scene):
    sim = scene([mount(), wall()], [ray(rate=25.0)], physics_dt=0.01)
    sensor, asked = sim.get_sensor("ray"), counting(sim)
    sim.update(step=1)
    assert asked == []  # a sensor that is not read casts no ray
    sensor.read_distance(), sensor.read_position()
    assert asked == [None]
    sim.update(step=2)
    sim.reset_objects_state([1])
    sensor.read_distance()
    assert asked == [None, [1]]
    sim.update(step=1)
    sensor.read_distance()
    assert asked == [None, [1], [0, 2]]  # 0.04 s in environments 0 and 2


@pytest.mark.parametrize("rate", [None, 1000.0])
def test_environments_that_did_not_move_are_not_measured_again(scene, rate):
    sim = scene([mount(), wall()], [ray(rate=rate)], physics_dt=0.01)
    sensor, asked = sim.get_sensor("ray"), counting(sim)
    sim.update(step=1)
    kept = sensor.read_distance()
    box = sim.get_rigid_object("cube")
    pose = box.get_local_pose()[[2]]
    pose[:, 0] = 0.5
    box.set_local_pose(pose, [2])
    sim.engine.forward()  # nothing moves
    np.testing.assert_allclose(sensor.read_distance()[:, 0], [1.5, 1.5, 1.0], atol=1e-6)
    assert asked == [None, [2]]
    np.testing.assert_array_equal(sensor.read_distance()[:2], kept[:2])
    sim.engine.write_model("geom_size", 0.2, np.array([0]), np.array([3]))  # thicker by 0.1 m
    sensor.read_distance()
    assert asked == [None, [2], [0]]
    sim.update(step=1)
    sensor.read_distance()
    assert asked == [None, [2], [0], None]
