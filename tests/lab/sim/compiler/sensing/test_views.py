"""Camera views: where they are, what they follow, and what is said about wrong ones."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.configs.scene_cfg import ViewCfg
from embodichain.lab.sim.shapes import CubeCfg, PlaneCfg
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.utils.errors import ConfigError

EYE_ROBOT = """<mujoco><worldbody><body name="base"><geom size=".1" mass="1"/>
  <body name="arm" pos="0 0 1"><joint name="turn" axis="0 0 1"/><geom size=".1" mass="1"/>
    <camera name="eye" pos=".3 0 0" xyaxes="0 -1 0 0 0 1" fovy="70"/>
    <camera name="lens" sensorsize=".02 .01" focal=".01 .01" resolution="20 10"/>
  </body></body></worldbody></mujoco>"""


def scene(views, *objects, robot=None, **fields):
    """A simulation with views, boxes of 20 cm (uid -> position) and a robot from a text."""
    views = {name: ViewCfg(**view) for name, view in views.items()}
    sim = SimulationManager(SimulationManagerCfg(headless=True, views=views, **fields))
    if robot is not None:
        sim.add_robot(RobotCfg(uid="r", fpath=str(robot)))
    for uid, pos in objects:
        attrs = RigidBodyAttributesCfg(mass=1.0)
        shape = CubeCfg(size=[0.2, 0.2, 0.2])
        sim.add_rigid_object(RigidObjectCfg(uid=uid, shape=shape, attrs=attrs, init_pos=pos))
    return sim


def camera(sim, name):
    """Position and axes of a camera in environment 0."""
    data = sim.engine.data_of(0)
    found = data.camera(name)
    return found.xpos, found.xmat.reshape(3, 3)


def test_eye_and_target_give_the_pose():
    sim = scene({"side": {"eye": [2, 0, 1], "target": [0, 0, 1], "fovy": 30}}, ("a", [0, 0, 1]))
    pos, axes = camera(sim, "side")
    np.testing.assert_allclose(pos, [2, 0, 1])
    # Looking along -x with z up, right is +y and backwards is +x.
    np.testing.assert_allclose(axes, [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    assert sim.scene.model.camera("side").fovy == 30
    assert sim.scene.model.camera("default").fovy == 40


def test_up_turns_the_picture_and_may_be_parallel_to_the_view():
    down = {"eye": [0, 0, 3], "target": [0, 0, 0]}
    sim = scene({"top": {**down, "up": [0, 1, 0]}, "any": down}, ("a", [0, 0, 0.1]))
    np.testing.assert_allclose(camera(sim, "top")[1], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(camera(sim, "any")[1][:, 1], [1, 0, 0], atol=1e-12)


def test_without_a_target_the_middle_of_the_objects_is_in_the_middle():
    sim = scene({"front": {"eye": [5, 1, 1]}}, ("a", [0, 0, 1]), ("b", [0, 2, 1]))
    pos, axes = camera(sim, "front")
    np.testing.assert_allclose(axes.T @ (np.array([0, 1, 1]) - pos), [0, 0, -5], atol=1e-12)


@pytest.mark.parametrize("view", [None, {"direction": [1, 2, 3]}, {"direction": [0, -1, 0.1]}])
def test_a_view_from_a_direction_shows_all_objects_and_not_much_more(view):
    at = {"a": [0.0, 0.0, 1.0], "b": [1.5, -0.5, 0.3], "c": [-1.0, 2.0, 0.1]}
    sim = scene({} if view is None else {"default": view}, *at.items())
    pos, axes = camera(sim, "default")
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    corners = np.concatenate([np.array(p) + 0.1 * signs for p in at.values()])
    local = (corners - pos) @ axes
    assert (local[:, 2] < 0).all()  # in front of the camera
    half = np.tan(np.radians(20.0))
    across = local[:, 0] / -local[:, 2] / (half * 4 / 3)
    along = local[:, 1] / -local[:, 2] / half
    # The widest direction fills 1 / 1.2 of the picture, and both are centred.
    assert max(np.abs(across).max(), np.abs(along).max()) == pytest.approx(1 / 1.2, abs=1e-9)
    for values in (across, along):
        if np.abs(values).max() == pytest.approx(1 / 1.2, abs=1e-6):
            assert -values.min() == pytest.approx(values.max(), abs=1e-9)
    if view is not None:
        wanted = np.array(view["direction"]) / np.linalg.norm(view["direction"])
        np.testing.assert_allclose(axes[:, 2], wanted, atol=1e-12)


def test_a_view_may_show_some_objects_with_more_room():
    at = ("a", [0, 0, 1]), ("b", [1.5, -0.5, 0.3]), ("far", [9, 9, 1])
    alone, _ = camera(scene({"default": {"direction": [1, 2, 3]}}, *at[:2]), "default")
    view = {"direction": [1, 2, 3], "show": ["a", "b"]}
    pos, axes = camera(scene({"default": view}, *at), "default")
    np.testing.assert_allclose(pos, alone, atol=1e-12)
    wide, _ = camera(scene({"default": view | {"margin": 2.4}}, *at), "default")
    assert (wide - pos) @ axes[:, 2] > 1.5  # metres farther back: twice the margin
    assert np.abs((wide - pos) @ axes[:, :2]).max() < 0.3


def test_the_ground_and_hidden_shapes_do_not_widen_the_view():
    alone = camera(scene({}, ("a", [0, 0, 1])), "default")[0]
    sim = scene({}, ("a", [0, 0, 1]))
    plane = RigidObjectCfg(uid="wall", shape=PlaneCfg(size=[50, 50]), body_type="static")
    sim.add_rigid_object(plane)
    np.testing.assert_allclose(camera(sim, "default")[0], alone)
    assert np.isfinite(camera(scene({}), "default")[0]).all()  # nothing to show


def turned(sim, uid):
    """Move an object to (3, 2, 1) and turn it by a quarter about z."""
    half = np.sqrt(0.5)
    sim.get_rigid_object(uid).set_local_pose(np.array([[3, 2, 1, half, 0, 0, half]]))


@pytest.mark.parametrize("start", [[1, 0, 0, 0], [0.8, 0.6, 0, 0]])
def test_a_view_follows_the_position_of_a_body(start):
    views = {"chase": {"body": "a", "eye": [-1, 0, 0.5], "target": [0, 0, 0.5]}}
    sim = scene(views)
    sim.add_rigid_object(RigidObjectCfg(uid="a", shape=CubeCfg(), init_quat=start))
    sim.reset_objects_state()
    pos, axes = camera(sim, "chase")
    np.testing.assert_allclose(pos, [-1, 0, 0.5], atol=1e-12)
    turned(sim, "a")
    moved, still = camera(sim, "chase")
    np.testing.assert_allclose(moved, [2, 2, 1.5], atol=1e-12)
    np.testing.assert_allclose(still, axes, atol=1e-12)
    np.testing.assert_allclose(axes[:, 2], [-1, 0, 0], atol=1e-12)


def test_a_view_may_be_fixed_on_a_body():
    views = {"rider": {"body": "a", "follow": "pose", "eye": [-1, 0, 0.5], "target": [0, 0, 0.5]}}
    sim = scene(views, ("a", [0, 0, 1]))
    turned(sim, "a")
    pos, axes = camera(sim, "rider")
    np.testing.assert_allclose(pos, [3, 1, 1.5], atol=1e-12)  # its x axis is now y
    np.testing.assert_allclose(axes[:, 2], [0, -1, 0], atol=1e-12)


def test_a_view_may_follow_a_link_or_be_a_camera_of_a_file(tmp_path):
    path = tmp_path / "r.xml"
    path.write_text(EYE_ROBOT)
    views = {
        "link": {"body": "r/arm", "eye": [0, -1, 0]},
        "file": {"camera": "r/eye"},
        "wide": {"camera": "r/eye", "fovy": 100},
        "lens": {"camera": "r/lens"},
    }
    sim = scene(views, robot=path)
    sim.get_robot("r").set_qpos([np.pi / 2], target=False)
    np.testing.assert_allclose(camera(sim, "link")[0], [0, -1, 1], atol=1e-12)
    for name, fovy in (("file", 70), ("wide", 100)):
        pos, axes = camera(sim, name)
        np.testing.assert_allclose(pos, [0, 0.3, 1], atol=1e-12)
        np.testing.assert_allclose(axes, camera(sim, "r/eye")[1], atol=1e-12)
        assert sim.scene.model.camera(name).fovy == fovy
    model = sim.scene.model
    for field in ("cam_sensorsize", "cam_intrinsic", "cam_resolution"):
        values = getattr(model, field)
        np.testing.assert_array_equal(
            values[model.camera("lens").id], values[model.camera("r/lens").id]
        )


def test_views_are_in_saved_files():
    views = {"side": {"eye": [2, 0, 1], "target": [0, 0, 1]}}
    scene_ = scene(views, ("a", [0, 0, 1])).scene
    again = mujoco.MjModel.from_xml_string(scene_.spec.to_xml())
    for name in ("side", "default"):
        np.testing.assert_allclose(again.camera(name).pos, scene_.model.camera(name).pos, 1e-5)
        turn = abs(again.camera(name).quat @ scene_.model.camera(name).quat)
        assert turn == pytest.approx(1.0, abs=1e-9)


WRONG = {
    "nothing": ({}, "views.v: needs one of eye, direction, camera, got none"),
    "two": (
        {"eye": [1, 0, 0], "direction": [1, 0, 0]},
        "views.v: needs one of eye, direction, camera, got eye and direction",
    ),
    "no length": ({"direction": [0, 0, 0]}, "views.v.direction: must not be zero"),
    "no up": ({"eye": [1, 0, 0], "up": [0, 0, 0]}, "views.v.up: must not be zero"),
    "inside": (
        {"eye": [1, 0, 0], "target": [1, 0, 0]},
        "views.v.eye: the camera is at the point it looks at",
    ),
    "on the body": ({"eye": [0, 0, 0], "body": "a"}, "views.v.eye: the camera is at the point"),
    "no such body": (
        {"eye": [1, 0, 0], "body": "b"},
        "views.v.body: no entity or link is called 'b'; there are: a",
    ),
    "no such part of a body": (
        {"eye": [1, 0, 0], "body": "a/lid"},
        "views.v.body: no link of 'a' matches 'lid'; there are: a",
    ),
    "no such camera": (
        {"camera": "r/eye"},
        "views.v.camera: no camera is called 'r/eye'; there are: none",
    ),
    "camera and target": (
        {"camera": "r/eye", "target": [0, 0, 0]},
        "views.v.target: has no effect on a camera of a file",
    ),
    "camera and up": (
        {"camera": "r/eye", "up": [1, 0, 0]},
        "views.v.up: has no effect on a camera of a file",
    ),
    "direction of a body": (
        {"direction": [1, 0, 0], "body": "a"},
        "views.v.body: needs eye, relative to the body, not direction",
    ),
}


@pytest.mark.parametrize(("view", "says"), WRONG.values(), ids=WRONG)
def test_wrong_views_are_refused(view, says):
    with pytest.raises(ConfigError) as caught:
        scene({"v": view}, ("a", [0, 0, 1])).compile()
    assert any(str(problem).startswith(says) for problem in caught.value.problems)


def test_names_of_views_are_checked(tmp_path):
    path = tmp_path / "r.xml"
    path.write_text(EYE_ROBOT)
    with pytest.raises(ConfigError, match=r"views\.a/b: a view's name must not contain '/'"):
        scene({"a/b": {"eye": [1, 0, 0]}}).compile()


def test_render_takes_a_view():
    sim = scene({"up": {"eye": [0, 0, 1], "target": [0, 0, 2]}}, ("a", [0, 0, 0.1]))
    sky, box = sim.render(camera="up", width=64, height=48), sim.render(width=64, height=48)
    assert np.abs(sky.astype(int) - box).max() > 50
    with pytest.raises(ValueError, match="Did you mean 'up'"):
        sim.render(camera="upp")
