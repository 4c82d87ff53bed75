"""`halo` and `reached` of objects: what pictures for people show, and nothing else notices."""

from contextlib import nullcontext
from types import SimpleNamespace

import mujoco
import mujoco.viewer
import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    HaloCfg,
    MarkCfg,
    ReachedCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.configs.scene_cfg import GroundCfg, SceneCfg, ViewCfg
from embodichain.lab.sim.drawing.views import view_of
from embodichain.lab.sim.shapes import CubeCfg, SphereCfg, VisualMaterialCfg
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.lab.sim.viewer import NativeViewer
from embodichain.learning.checkpoints.physics_values import physics_values
from embodichain.utils.errors import ConfigError

ABOVE = {"top": ViewCfg(eye=[0, 0, 3], target=[0, 0, 0.5], up=[0, 1, 0], fovy=20)}
GREY = SceneCfg(ground=GroundCfg(type="plain", colors=[[0.5, 0.5, 0.5]]))


def marked(num_envs=1, **marks):
    """A blue ball of 4 cm at the origin, 50 cm high, and a cube that is 20 cm beside it."""
    sim = SimulationManager(
        SimulationManagerCfg(headless=True, scene=GREY, views=ABOVE, num_envs=num_envs)
    )
    blue = VisualMaterialCfg(base_color=[0.1, 0.2, 0.9, 1])
    sim.add_rigid_object(
        RigidObjectCfg(
            uid="goal",
            shape=SphereCfg(radius=0.04, visual_material=blue),
            body_type="kinematic",
            attrs=RigidBodyAttributesCfg(enable_collision=False),
            init_pos=[0, 0, 0.5],
            **marks,
        )
    )
    sim.add_rigid_object(
        RigidObjectCfg(
            uid="cube",
            shape=CubeCfg(size=[0.02, 0.02, 0.02]),
            body_type="kinematic",
            init_pos=[0.2, 0, 0.5],
        )
    )
    return sim


def blue_share(picture):
    """The share of pixels that are rather blue than grey."""
    colors = picture[..., :3].astype(int)
    return float((colors[..., 2] - colors[..., 0] > 25).mean())


def middle(picture):
    """RGB in the middle, where the ball is."""
    height, width = picture.shape[:2]
    return picture[height // 2, width // 2, :3].astype(int)


def test_a_halo_is_seen_by_people_and_by_no_sensor():
    plain = marked().render(camera="top", width=120, height=120)
    sim = marked(halo=HaloCfg(radius=0.12))
    with_halo = sim.render(camera="top", width=120, height=120)
    # Seen, an area nine times that of the ball, and the ball through it.
    assert blue_share(with_halo) > 5 * blue_share(plain) > 0
    assert middle(with_halo)[2] > middle(with_halo)[0] + 60
    for look in ("fast", "full"):
        view = view_of(sim.engine, "top", 120, 120, look=look, outputs=("color", "mask"))
        (seen,) = sim.draw([view])
        assert blue_share(seen["color"][0]) == pytest.approx(blue_share(plain), abs=2e-3)
    # Both in one call, in their order.
    people = view_of(sim.engine, "top", 120, 120, look="full", marks=True)
    drawn = sim.draw([view, people, view])
    np.testing.assert_array_equal(drawn[1]["color"][0, ..., :3], with_halo)
    np.testing.assert_array_equal(drawn[0]["color"], drawn[2]["color"])
    assert blue_share(drawn[0]["color"][0]) < blue_share(with_halo)


def test_marks_change_no_physics():
    reached = ReachedCfg(by="cube", within=0.05)
    sims = [marked(), marked(halo=HaloCfg(radius=0.12), reached=reached)]
    values = [physics_values(sim.scene.model) for sim in sims]
    assert values[0] == values[1]
    goals = [sim.get_rigid_object("goal").entity.geom_ids for sim in sims]
    assert len(goals[0]) == len(goals[1]) == 1
    hits = [
        sim.engine.cast_rays(
            np.array([[[0.0, 0.0, 3.0]]]),
            np.array([[[0.0, 0.0, -1.0]]]),
            np.ones(sim.scene.model.ngeom, bool),
            None,
        )
        for sim in sims
    ]
    np.testing.assert_allclose(hits[0].distance, hits[1].distance)
    np.testing.assert_allclose(hits[1].distance, 3.0 - 0.54, atol=1e-6)


def test_what_is_reached_is_green_in_its_environment_alone():
    reached = ReachedCfg(by="cube", within=0.05, offset=[0.0, 0.1, 0.0])
    sim = marked(num_envs=3, halo=HaloCfg(radius=0.08), reached=reached)
    pose = np.tile(np.eye(4), (3, 1, 1))
    pose[:, :3, 3] = [[0.2, 0.1, 0.5], [0.04, 0.1, 0.5], [0.04, 0.0, 0.5]]
    sim.get_rigid_object("cube").set_local_pose(pose)
    far, near, beside_the_offset = sim.render(None, camera="top", width=120, height=120)
    assert middle(far)[2] > middle(far)[1] + 60
    assert middle(beside_the_offset)[2] > middle(beside_the_offset)[1] + 60
    assert middle(near)[1] > middle(near)[2] + 60
    halo = near[60, 60 + 8]  # beside the ball: 6 of the 8 cm
    assert int(halo[1]) - int(halo[2]) > 10
    # Who acts on pictures does not see that it is there.
    (seen,) = sim.draw([view_of(sim.engine, "top", 120, 120, look="full")])
    assert middle(seen["color"][1])[2] > middle(seen["color"][1])[1] + 60


def button(num_envs=1, **marks):
    """A button at the origin, whose cap is marked, seen from above."""
    views = {"top": ViewCfg(eye=[0, 0, 1], target=[0, 0, 0], up=[0, 1, 0], fovy=12)}
    sim = SimulationManager(
        SimulationManagerCfg(headless=True, scene=GREY, views=views, num_envs=num_envs)
    )
    cfg = ArticulationCfg(
        uid="button",
        fpath="PushButton/push_button.xml",
        marks={"cap": MarkCfg(**marks)},
    )
    sim.add_articulation(cfg)
    return sim


PRESSED = ReachedCfg(joint="button/press", above=0.008)


@pytest.mark.parametrize("renderer", ["layered", "classic"])
def test_what_a_joint_moves_is_green_once_it_is_past(renderer, monkeypatch):
    monkeypatch.setenv("EMBODICHAIN_RENDERER", renderer)
    sim = button(num_envs=2, halo=HaloCfg(radius=0.05, color=[0.1, 0.2, 0.9]), reached=PRESSED)
    sim.compile()
    sim.articulations["button"].set_qpos([[0.0], [0.01]], target=False)
    free, pressed = sim.render(None, camera="top", width=96, height=96).astype(int)
    assert free[48, 48, 0] > free[48, 48, 1] + 25  # a red cap
    assert pressed[48, 48, 1] > pressed[48, 48, 0] + 25
    halo = (slice(46, 50), slice(66, 69))  # beside the cap, on the collar: 4.4 of 5 cm
    assert free[halo][..., 2].mean() > free[halo][..., 1].mean() + 8
    assert pressed[halo][..., 1].mean() > pressed[halo][..., 2].mean() + 8
    (seen,) = sim.draw([view_of(sim.engine, "top", 96, 96, look="full")])
    np.testing.assert_array_equal(seen["color"][0, 46:50, 46:50], seen["color"][1, 46:50, 46:50])


def test_marks_of_links_change_no_model():
    """But for a text: no geom, body or physics."""
    plain = SimulationManager(SimulationManagerCfg(headless=True, scene=GREY))
    plain.add_articulation(ArticulationCfg(uid="button", fpath="PushButton/push_button.xml"))
    marked_sim = button(halo=HaloCfg(radius=0.05), reached=PRESSED)
    models = [sim.scene.model for sim in (plain, marked_sim)]
    assert models[0].ngeom == models[1].ngeom
    assert models[0].nbody == models[1].nbody
    assert physics_values(models[0]) == physics_values(models[1])


def test_the_window_shows_marks_beside_the_model(monkeypatch):
    scenes = []

    def open_window(model, data, key_callback):
        scenes.append(mujoco.MjvScene(model, 100))
        return SimpleNamespace(
            is_running=lambda: True,
            lock=nullcontext,
            sync=lambda: None,
            user_scn=scenes[-1],
        )

    # There is no display here: this window notes what it is told to draw.
    monkeypatch.setattr("mujoco.viewer.launch_passive", open_window)
    monkeypatch.setenv("DISPLAY", ":0")
    sim = button(num_envs=2, halo=HaloCfg(radius=0.05), reached=PRESSED)
    sim.compile()
    sim.articulations["button"].set_qpos([[0.0], [0.01]], target=False)
    shown = []
    for env_id in (0, 1):
        NativeViewer(sim.engine, env_id)
        geoms = scenes[-1].geoms[: scenes[-1].ngeom]
        shown.append([(geom.type, tuple(np.round(geom.rgba, 2))) for geom in geoms])
    sphere = int(mujoco.mjtGeom.mjGEOM_SPHERE)
    cylinder = int(mujoco.mjtGeom.mjGEOM_CYLINDER)
    (halo,) = shown[0]
    assert halo[0] == sphere and halo[1][0] > halo[1][1]
    # Where it is pressed the halo is green, and so are covers around cap and stem.
    assert [kind for kind, _ in shown[1]] == [sphere, cylinder, cylinder]
    assert all(rgba[1] > rgba[0] for _, rgba in shown[1])


@pytest.mark.parametrize(
    ("marks", "says"),
    [
        ({"knob": {}}, r"button.marks.knob: .*'knob'"),
        ({"cap": {"reached": {}}}, r"button.marks.cap.reached: needs one of by and joint"),
        (
            {"cap": {"reached": {"joint": "button/pres", "above": 1.0}}},
            r"button.marks.cap.reached.joint: 'button' has no joint 'pres'.*Did you mean 'press'",
        ),
        (
            {"cap": {"reached": {"joint": "buton/press", "above": 1.0}}},
            r"button.marks.cap.reached.joint: no entity is called 'buton'.*Did you mean 'button'",
        ),
        (
            {"cap": {"reached": {"joint": "button/press"}}},
            r"button.marks.cap.reached.joint: needs above or below",
        ),
        (
            {"cap": {"reached": {"joint": "button/press", "above": 0.0, "within": 1.0}}},
            r"button.marks.cap.reached.within: belongs to by",
        ),
        (
            {"cap": {"reached": {"by": "button"}}},
            r"button.marks.cap.reached.within: missing value",
        ),
    ],
)
def test_marks_that_say_nothing_are_refused(marks, says):
    cfg = {"uid": "button", "fpath": "PushButton/push_button.xml", "marks": marks}
    sim = SimulationManager(SimulationManagerCfg(headless=True))
    sim.add_articulation(ArticulationCfg.from_dict(cfg))
    with pytest.raises(ConfigError, match=says):
        sim.compile()


@pytest.mark.parametrize(
    ("by", "says"),
    [
        ("cub", r"goal.reached.by: no entity is called 'cub'.*Did you mean 'cube'"),
        ("cube/top", r"goal.reached.by: .*'top'"),
    ],
)
def test_what_cannot_be_near_is_refused(by, says):
    sim = marked(reached=ReachedCfg(by=by, within=0.05))
    with pytest.raises(ConfigError, match=says):
        sim.compile()
