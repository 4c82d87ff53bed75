"""Contact sensors: forces that follow from weights, who touches whom, several links and others."""

import numpy as np
import pytest

from embodichain.lab.sim.cfg import RobotCfg
from embodichain.lab.sim.sensors import ContactSensorCfg, LinksCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.sensors.conftest import cube

G = 9.81
TABLE_LEGS = """
<mujoco>
  <worldbody>
    <body name="top" pos="0 0 0.3">
      <freejoint/>
      <geom type="box" size=".2 .2 .02" mass="3"/>
      <body name="left_foot" pos="0.15 0 -0.15">
        <geom type="box" size=".05 .2 .13" mass="1"/>
      </body>
      <body name="right_foot" pos="-0.15 0 -0.15">
        <geom type="box" size=".05 .2 .13" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def contact(uid, on, against=None, **links):
    other = None if against is None else LinksCfg(**against)
    return ContactSensorCfg(uid=uid, of=LinksCfg(uid=on, **links), against=other)


def settle(sim, steps=150):
    sim.update(step=steps)


def test_a_cube_at_rest_weighs_on_the_ground(scene):
    sim = scene([cube("cube")], [contact("touch", "cube")])
    touch = sim.get_sensor("touch")
    settle(sim)
    assert touch.names == ("cube",)
    assert touch.read_found().tolist() == [[True]] * 3
    force = touch.read_force()
    assert force.shape == (3, 1, 3) and force.dtype == np.float64
    # 2 kg x 9.81 m/s^2, upwards on the cube
    np.testing.assert_allclose(force[:, 0, 2], 2.0 * G, rtol=1e-3)
    np.testing.assert_allclose(force[:, 0, :2], 0.0, atol=1e-3)


def test_a_cube_in_the_air_touches_nothing(scene):
    sim = scene([cube("cube", pos=(0, 0, 5))], [contact("touch", "cube")])
    settle(sim, 10)
    touch = sim.get_sensor("touch")
    assert not touch.read_found().any()
    assert (touch.read_force() == 0.0).all() and not np.signbit(touch.read_force()).any()


def test_a_stack_of_two_tells_who_presses_on_whom(scene):
    lower, upper = cube("lower", mass=2.0), cube("upper", pos=(0, 0, 0.15), mass=3.0)
    sim = scene(
        [lower, upper],
        [
            contact("net", "lower"),
            contact("ground", "lower", {"uid": "default_plane"}),
            contact("load", "lower", {"uid": "upper"}),
            contact("up", "upper", {"uid": "lower"}),
            contact("no", "upper", {"uid": "default_plane"}),
        ],
    )
    settle(sim, 300)
    force = {uid: sensor.read_force()[:, 0, 2] for uid, sensor in sim.sensors.items()}
    np.testing.assert_allclose(force["net"], 2.0 * G, rtol=1e-3)  # 5 g up, 3 g down
    np.testing.assert_allclose(force["ground"], 5.0 * G, rtol=1e-3)
    np.testing.assert_allclose(force["load"], -3.0 * G, rtol=1e-3)
    np.testing.assert_allclose(force["up"], 3.0 * G, rtol=1e-3)
    assert not sim.get_sensor("no").read_found().any()
    assert sim.get_sensor("load").read_found().all()


@pytest.fixture
def legs(tmp_path):
    path = tmp_path / "legs.xml"
    path.write_text(TABLE_LEGS)
    return RobotCfg(uid="legs", fpath=str(path), fix_base=False)


def test_every_link_has_its_own_column(scene, legs):
    sim = scene(
        [cube("load", pos=(0, 0, 0.38), mass=2.0)],
        [
            contact("feet", "legs", link_names=".*_foot"),
            contact("turned", "legs", link_names=["right.*", "left.*"], preserve_order=True),
            contact("all", "legs"),
            contact("top", "load", {"uid": "legs", "link_names": ["top"]}),
            contact("sum", "load", {"uid": "legs", "link_names": ["left.*", "top"]}),
            contact("tree", "load", {"uid": "legs"}),
        ],
        robots=[legs],
    )
    settle(sim, 400)
    feet = sim.get_sensor("feet")
    assert feet.names == ("left_foot", "right_foot")
    assert sim.get_sensor("turned").names == ("right_foot", "left_foot")
    assert sim.get_sensor("all").names == ("top", "left_foot", "right_foot")
    # 3 + 1 + 1 kg and the load of 2 kg, shared alike
    np.testing.assert_allclose(feet.read_force()[:, :, 2], 7.0 * G / 2, rtol=1e-3)
    both = sim.get_sensor("all").read_force()
    np.testing.assert_array_equal(both[:, 1:], feet.read_force())
    np.testing.assert_allclose(both[:, 0, 2], -2.0 * G, rtol=1e-3)  # the top carries the load
    for uid in ("top", "sum", "tree"):
        np.testing.assert_allclose(sim.get_sensor(uid).read_force()[:, 0, 2], 2.0 * G, rtol=1e-3)
        assert sim.get_sensor(uid).read_found().all()


def test_forces_are_those_of_each_environment(scene):
    sim = scene([cube("cube")], [contact("touch", "cube")])
    pose = sim.get_rigid_object("cube").get_local_pose()
    pose[1, 2] = 4.0
    sim.get_rigid_object("cube").set_local_pose(pose)
    settle(sim, 50)
    touch = sim.get_sensor("touch")
    assert touch.read_found()[:, 0].tolist() == [True, False, True]
    data = touch.get_data()
    assert data["found"].tolist() == [[1.0], [0.0], [1.0]]
    assert data["force"].shape == (3, 1, 3) and str(data["force"].dtype) == "torch.float32"


@pytest.mark.parametrize(
    ("cfg", "path", "match"),
    [
        (contact("touch", "cub"), "touch.of.uid", "there are: cube"),
        (contact("touch", "cube", link_names="x.*"), "touch.of.link_names", "no link"),
        (contact("touch", "cube", link_names=[]), "touch.of.link_names", "names no link"),
        (contact("touch", "cube", {"uid": "plane"}), "touch.against.uid", "default_plane, cube"),
        (
            contact("touch", "cube", {"uid": "default_plane", "link_names": "x"}),
            "touch.against.link_names",
            "no links",
        ),
        (contact("cube", "cube"), "cube", "taken"),
    ],
)
def test_a_wrong_sensor_is_refused_with_what_exists(scene, cfg, path, match):
    with pytest.raises(ConfigError, match=match) as error:
        scene([cube("cube")], [cfg])
    assert [p.path for p in error.value.problems] == [path]


def test_without_a_ground_plane_nothing_can_touch_it(scene):
    with pytest.raises(ConfigError, match="no entity is called 'default_plane'"):
        scene([cube("a")], [contact("t", "a", {"uid": "default_plane"})], ground_plane=False)


def test_sensors_are_added_before_the_scene_is_compiled(scene):
    sim = scene([cube("cube")], [])
    sim.update(step=1)
    with pytest.raises(RuntimeError, match="compiled already"):
        sim.add_sensor(contact("touch", "cube"))


def test_a_sensor_may_be_taken_back(scene):
    sim = scene([cube("cube")], [contact("touch", "cube")])
    assert sim.asset_uids == ["default_plane", "cube", "touch"]
    assert sim.remove_asset("touch") and sim.get_sensor("touch") is None
    sim.update(step=1)
    assert sim.engine.model.nsensor == 0


def test_a_sensor_that_can_hear_nothing_says_so(scene, caplog):
    from embodichain.lab.sim.cfg import RigidBodyAttributesCfg

    ghost = cube("ghost", body_type="kinematic")
    ghost.attrs = RigidBodyAttributesCfg(enable_collision=False)
    sim = scene([cube("cube"), ghost], [contact("deaf", "ghost"), contact("fine", "cube")])
    sim.compile()
    assert [r.getMessage() for r in caplog.records] == [
        "deaf: no shape of ghost collides, so it reports no contact"
    ]
