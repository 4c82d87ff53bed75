"""Scenes from MJCF files: what they bring, where it begins, and what is said about the rest."""

import logging

import mujoco
import numpy as np
import pytest

from embodichain.lab.gym.envs import BaseEnv, EnvCfg
from embodichain.lab.sim.cfg import RigidObjectCfg, RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.configs.scene_cfg import GroundCfg, LightCfg, SceneCfg, SkyCfg
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.utils.errors import ConfigError
from tests.helpers.kitchen import KITCHEN
from tests.lab.sim.compiler.helpers import UR10


@pytest.fixture
def kitchen(tmp_path):
    path = tmp_path / "kitchen.xml"
    path.write_text(KITCHEN)
    return str(path)


def built(path, robot=None, num_envs=2, **scene):
    cfg = SimulationManagerCfg(headless=True, num_envs=num_envs, physics_dt=0.005)
    cfg.scene = SceneCfg(fpath=path, **scene)
    sim = SimulationManager(cfg)
    if robot is not None:
        sim.add_robot(robot)
    return sim


def test_everything_of_the_file_is_in_the_model(kitchen):
    robot = RobotCfg(uid="ur10", fpath=UR10, init_pos=[1.5, 0, 0.5])
    sim = built(kitchen, robot)
    model = sim.scene.model
    names = [model.body(i).name for i in range(1, 7)]
    assert names[:5] == [f"scene/{n}" for n in ("counter", "cup", "cupboard", "door", "hand")]
    assert names[5] == "ur10/base_link"
    assert [model.camera(i).name for i in range(model.ncam)] == ["scene/overview", "default"]
    assert [model.light(i).name for i in range(model.nlight)] == ["scene/lamp"]
    kinds = [mujoco.mjtTexture(int(kind)).name for kind in model.tex_type]
    assert kinds.count("mjTEXTURE_SKYBOX") == 1 and model.texture("scene/tiles")
    np.testing.assert_allclose(model.vis.headlight.ambient, 0.2, atol=1e-7)
    np.testing.assert_allclose(model.joint("scene/hinge").range, np.radians([-120, 0]))
    assert "default_plane" not in sim.asset_uids  # the ground is the file's
    assert model.geom_friction[model.geom("scene/top").id, 0] == 0.9
    assert model.geom_friction[model.geom_bodyid > 6, 0].max() == 0.5  # not the robot's
    assert model.opt.timestep == 0.005 and model.opt.gravity[2] == -9.81


def test_ground_sky_and_lights_of_the_task_replace_or_join_the_files(kitchen):
    sim = built(kitchen, ground=GroundCfg(), sky=SkyCfg(), ambient=0.5)
    sim.add_light(LightCfg(uid="more"))
    model = sim.scene.model
    assert model.texture("sky").type[0] == int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    kinds = model.tex_type.tolist()
    assert kinds.count(int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)) == 1
    assert {model.light(i).name for i in range(model.nlight)} == {"scene/lamp", "more"}
    assert "default_plane" in sim.asset_uids
    assert model.vis.headlight.ambient[1] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("keyframe", "cup", "hinge", "ctrl"),
    [(None, [0.1, 0.4, 0.86], -1, -1), ("home", [0.1, 0.4, 0.86], -1, -1), ("closed", None, 0, 0)],
)
def test_it_begins_at_a_keyframe(kitchen, keyframe, cup, hinge, ctrl):
    robot = RobotCfg(uid="ur10", fpath=UR10, init_pos=[1.5, 0, 0.5], init_qpos=[1, 0, 0, 0, 0, 0])
    sim = built(kitchen, robot, keyframe=keyframe)
    pos = sim.get_rigid_object("cup").read_pose()[0]
    np.testing.assert_allclose(pos, [cup or [0, 0.4, 0.86]] * 2)
    model, qpos = sim.scene.model, sim.engine.state("qpos")
    assert (qpos[:, model.joint("scene/hinge").qposadr[0]] == hinge).all()
    opener = model.actuator_ctrladr[model.actuator("scene/opener").id]
    assert (sim.engine.state("ctrl")[:, opener] == ctrl).all()
    np.testing.assert_array_equal(sim.get_robot("ur10").read_qpos()[:, 0], 1)
    np.testing.assert_allclose(sim.get_rigid_object("hand").read_pose()[0], [[-0.5, 0, 1]] * 2)


def test_its_bodies_are_entities(kitchen):
    sim = built(kitchen)
    kinds = {uid: obj.cfg.body_type for uid, obj in sim.rigid_objects.items()}
    assert kinds == {
        "counter": "static",
        "cup": "dynamic",
        "cupboard": "static",
        "hand": "kinematic",
    }
    half = np.sqrt(0.5)
    sim.get_rigid_object("hand").set_local_pose(np.array([[0, 0, 2, half, 0, 0, half]]), [1])
    sim.get_rigid_object("cup").set_velocity(np.array([[1.0, 0, 0]]), env_ids=[0])
    sim.update(step=4)
    np.testing.assert_allclose(sim.get_rigid_object("hand").read_pose()[0][:, 2], [1, 2])
    x = sim.get_rigid_object("cup").read_pose()[0][:, 0]
    assert x[0] > x[1] + 0.01


def test_the_cup_keeps_the_files_damping(kitchen):
    sim = built(kitchen)
    cup = sim.get_rigid_object("cup")
    dofs = slice(*sim.scene.model.joint("scene/cup_free").dofadr + np.array([0, 6]))
    np.testing.assert_allclose(sim.scene.model.dof_damping[dofs], 0.02)
    cup.set_mass([2 * float(cup.get_mass()[0])] * 2)
    # Twice the mass decays at the same rate with twice the damping, as declared objects do.
    np.testing.assert_allclose(sim.engine.model_field("dof_damping")[:, dofs][:, :3], 0.04)


def test_a_reset_restores_joints_of_the_file(kitchen):
    sim = built(kitchen)
    first = sim.engine.rows.copy()
    address = sim.scene.model.joint("scene/hinge").qposadr[0]
    for excluded in ((), ("cup",)):
        sim.engine.write("qpos", -0.5, None, slice(address, address + 1))
        sim.update(step=3)
        sim.reset_objects_state(excluded_uids=excluded)
        assert (sim.engine.state("qpos")[:, address] == -1).all()
    sim.reset_objects_state()
    np.testing.assert_array_equal(sim.engine.rows, first)
    sim.get_rigid_object("cupboard").reset()
    np.testing.assert_array_equal(sim.engine.rows, first)


def test_what_is_not_used_is_said_once(kitchen, caplog):
    with caplog.at_level(logging.WARNING):
        sim = built(kitchen)
        sim.compile()
        sim.update(step=1)
    said = [r.message.replace(kitchen, "FILE") for r in caplog.records]
    assert said == [
        "FILE: it starts at its keyframe 'home'; left out: 'closed'",
        "FILE: no action moves its actuators, their controls stay as at the start: 'opener'",
        "FILE: no term reads its sensors: 'angle'",
        "scene.fpath: FILE: the scene's physics replaces its options: gravity 0 0 -3 -> 0 0 -9.81; "
        "timestep 0.003 -> 0.005",
    ]


def test_its_bodies_stay_and_their_names_are_taken(kitchen):
    sim = built(kitchen)
    with pytest.raises(ValueError, match="part of the scene's file"):
        sim.remove_asset("cup")
    with pytest.raises(ConfigError, match="'cup' is taken"):
        sim.add_rigid_object(RigidObjectCfg(uid="cup", shape=CubeCfg()))
    scene = SceneCfg(fpath=kitchen)
    with pytest.raises(ConfigError, match=r"objects\.cup: uid 'cup' is taken by the scene's file"):
        BaseEnv(EnvCfg(scene=scene, objects={"cup": RigidObjectCfg()}))
    with pytest.raises(ConfigError, match="'scene' is taken by the scene's file"):
        BaseEnv(EnvCfg(scene=scene, objects={"scene": RigidObjectCfg()}))


WRONG = {
    "no file": ({"fpath": "no/such.xml"}, r"scene\.fpath: no file or folder for 'no/such\.xml'"),
    "a robot": ({"fpath": UR10}, r"scene\.fpath: .*a URDF is a robot"),
    "no such keyframe": (
        {"keyframe": "opn"},
        r"scene\.keyframe: no keyframe is called 'opn'; there are: closed, home",
    ),
}


@pytest.mark.parametrize(("change", "says"), WRONG.values(), ids=WRONG)
def test_wrong_files_are_refused(kitchen, change, says):
    with pytest.raises(ConfigError, match=says):
        BaseEnv(EnvCfg(scene=SceneCfg(**{"fpath": kitchen, **change})))


def test_a_file_that_scales_all_masses_is_refused(tmp_path):
    path = tmp_path / "heavy.xml"
    path.write_text(KITCHEN.replace('angle="degree"', 'angle="degree" settotalmass="7"'))
    with pytest.raises(ConfigError, match=r"scene\.fpath: .*settotalmass"):
        built(str(path))
