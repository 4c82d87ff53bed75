"""Scenes of tasks: tasks without a robot, views and looks of shipped tasks, as people use them."""

import json

import gymnasium as gym
import mujoco
import numpy as np
import pytest
import yaml

import embodichain
from embodichain.cli import main
from embodichain.config import list_options
from embodichain.config.composition.composed import compose
from embodichain.config.resolved import resolve
from embodichain.lab.gym.policies import resolve_policy
from embodichain.learning.checkpoints.physics_values import physics_values
from tests.helpers.kitchen import KITCHEN

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

TASKS = list_options("task")
FALL = {
    "description": "A cube falls.",
    "max_episode_steps": 10,
    "objects": {"cube": {"shape": {"shape_type": "Cube"}, "init_pos": [0, 0, 2]}},
    "observations": {"at": {"func": "position", "params": {"of": {"uid": "cube"}}}},
}
COOK = {
    "description": "A kitchen with a cup.",
    "max_episode_steps": 10,
    "scene": {"fpath": "kitchen.xml"},
    "views": {"all": {"camera": "scene/overview"}, "cup": {"body": "cup", "eye": [0.3, -0.4, 0.3]}},
    "events": {
        "place": {
            "func": "randomize_pose",
            "mode": "reset",
            "params": {"of": {"uid": "cup"}, "position_range": [[-0.2, 0, 0], [0.2, 0, 0]]},
        }
    },
    "observations": {"at": {"func": "position", "params": {"of": {"uid": "cup"}}}},
}

PENDULUM = """<mujoco><worldbody><body pos="0 0 1"><geom size="0.05"/>
  <body><joint name="hinge" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 -0.1 0 0 -0.5" size="0.02"/></body></body></worldbody>
  </mujoco>"""
SWING = {"max_episode_steps": 10, "robot": {"uid": "r", "fpath": "swing.xml", "init_qpos": [0.5]}}


@pytest.fixture
def write(tmp_path, monkeypatch):
    """``write(tree)``: the task ``mine`` in the working directory, with a kitchen beside it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kitchen.xml").write_text(KITCHEN)
    (tmp_path / "swing.xml").write_text(PENDULUM)

    def to(tree):
        (tmp_path / "conf" / "task").mkdir(parents=True, exist_ok=True)
        (tmp_path / "conf" / "task" / "mine.yaml").write_text(yaml.safe_dump(tree))

    return to


@pytest.mark.parametrize(
    "tree", [FALL, COOK, SWING], ids=["objects", "a scene's file", "a robot without actuators"]
)
def test_a_task_in_which_nothing_is_driven(write, tree, capsys):
    write(tree)
    assert main(["validate", "task=mine"]) == 0
    words = ["task=mine", "num_envs=3", "seed=1", "episodes=2", "scene_png=false"]
    assert main(["run", *words]) == 0
    assert main(["replay", "last", "--verify"]) == 0
    assert "20 steps of 3 environments are identical to the bit" in capsys.readouterr().out
    assert main(["show", "task=mine", "--json"]) == 0
    spaces = json.loads(capsys.readouterr().out)["spaces"]
    assert spaces[0] | {"low": None, "high": None} == {
        "space": "action",
        "shape": "(0,)",
        "type": "float32",
        "low": None,
        "high": None,
    }
    assert main(["train", "task=mine", "total_timesteps=100", "record=none"]) == 2
    assert "learning needs actions" in capsys.readouterr().err


def test_a_task_without_a_robot_in_python(write):
    write(COOK)
    env = embodichain.make("mine", num_envs=2, overrides=["seed=1"])
    assert isinstance(env.single_action_space, gym.spaces.Box) and env.action_space.shape == (2, 0)
    first = env.reset()[0]["at"].numpy()
    assert (np.abs(first[:, 0] - 0.1) <= 0.2).all() and first[0, 0] != first[1, 0]
    again = env.step(np.zeros((2, 0), np.float32))[0]["at"].numpy()
    np.testing.assert_allclose(again, first, atol=0.01)
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros((2, 1), np.float32))
    env.close()


def test_show_lists_surroundings_lights_and_views(capsys):
    assert main(["show", "task=lift_cube", "+task.scene.table={}", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    surroundings = {row["what"]: row["params"] for row in told["surroundings"]}
    assert set(surroundings) == {"ground", "sky", "table"} and "grid" in surroundings["ground"]
    assert [light["light"] for light in told["lights"]] == ["default"]
    views = {row["camera"]: row for row in told["cameras"]}
    assert {"default", "front", "top", "hand"} <= set(views)
    assert views["hand"]["on body"] == "robot/panda_hand_tcp" and "eye: [" in views["front"]["view"]
    assert "table" in [row["entity"] for row in told["initial poses"]]


def test_mistakes_are_reported_together_with_their_places(write, capsys):
    write({**COOK, "views": {"a": {}, "b": {"eye": [1, 0, 0], "body": "cupp"}}})
    words = ["+task.scene.pedestal={}", "+task.scene.table.size=[1,1,-1]"]
    assert main(["validate", "task=mine", "task.scene.keyframe=hom", *words]) == 2
    said = capsys.readouterr().err
    for line in (
        "command line: task.scene.table.size.2: must be greater than 0.0, got -1",
        "command line: task.scene.pedestal.size: missing value: the task has no robot",
        "command line: task.scene.keyframe: no keyframe is called 'hom'; there are: closed, home",
        "task.views.a: needs one of eye, direction, camera, got none",
    ):
        assert line in said
    assert "no entity is called 'cup'" not in said  # the file could not be read
    assert main(["validate", "task=mine"]) == 2
    assert "task.views.b.body: no entity or link is called 'cupp'" in capsys.readouterr().err


@pytest.mark.parametrize("task", ["reach", "lift_cube"])
def test_the_look_of_a_task_changes_no_physics(task):
    models = []
    for look in (["scene@task.scene=lab"], ["task.scene.ground=null", "task.scene.sky=null"], []):
        env = embodichain.make(task, overrides=["seed=1", *look])
        models.append(env.sim.scene.model)
        env.close()
    first, *others = (physics_values(model) for model in models)
    assert all(values == first for values in others)
    assert len({model.tex_data.tobytes() for model in models}) == 3


@pytest.mark.parametrize(
    ("task", "goal"), [("reach_vision", [0.05, 0.9, 0.1, 1]), ("lift_vision", [0.1, 0.7, 0.3, 1])]
)
def test_what_policies_see_in_pictures_is_written_down(task, goal):
    """The look that tasks share may change; the room of a policy that sees must not."""
    resolved = resolve(compose([f"task={task}"]), "run")
    scene = resolved.tree["task"]["scene"]
    assert scene["ground"]["type"] == "wood" and scene["ground"]["tile"] == 2.4
    assert scene["ground"].get("colors") is None
    assert list(scene["sky"]["top"]) == [0.42, 0.5, 0.6]
    assert list(scene["sky"]["horizon"]) == [0.88, 0.89, 0.9]
    for light in ("ambient", "headlight", "sun", "lights"):
        assert not scene.get(light)
    material = resolved.tree["task"]["objects"]["goal"]["shape"]["visual_material"]
    assert list(material["base_color"]) == goal


@pytest.mark.parametrize("task", TASKS)
def test_every_view_of_a_shipped_task_shows_the_robot(task):
    env = embodichain.make(task, overrides=["seed=1"])
    env.reset()
    data, robot = env.sim.engine.data_of(0), env.robot.entity
    views = {"default": None, **env.cfg.views}
    for name in views:
        camera = data.camera(name)
        points = data.xpos[robot.body_ids] - camera.xpos
        local = points @ camera.xmat.reshape(3, 3)
        slope = np.tan(np.radians(env.sim.scene.model.camera(name).fovy[0]) / 2)
        ahead = local[:, 2] < 0
        inside = ahead & (np.abs(local[:, 1]) < -slope * local[:, 2])
        inside &= np.abs(local[:, 0]) < -4 / 3 * slope * local[:, 2]
        share = inside.mean()
        # A view that is close to what the task is about may cut the elbow of an arm off.
        assert share >= 0.7 if name == "default" else share > 0.1, (name, share)
        if name == "default":
            assert inside[[0, -1]].all()  # the base, and the end of the arm or of the last leg
    env.close()


def test_robots_are_drawn_by_their_visual_meshes():
    """All of the Panda's and the Go2's; collision shapes are hidden."""
    for task, uid, least in (("lift_cube", "robot", 20), ("quadruped_velocity", "robot", 15)):
        env = embodichain.make(task, overrides=["seed=1"])
        model, geoms = env.sim.scene.model, env.sim.get_robot(uid).entity.geom_ids
        drawn = geoms[model.geom_group[geoms] < 3]
        assert (model.geom_type[drawn] == int(mujoco.mjtGeom.mjGEOM_MESH)).all()
        assert len(drawn) >= least and not model.geom_contype[drawn].any()
        assert not any("left out" in note for note in env.sim.get_robot(uid).parsed.notes)
        env.close()


@pytest.mark.parametrize("policy", ["zero", "random", "hold", "random_around_home"])
def test_policies_move_a_robot_without_actuators_as_mujoco_does(write, policy):
    write(SWING)
    env = embodichain.make("mine", num_envs=2)
    obs, _ = env.reset(seed=1)
    assert env.single_action_space.shape == (0,)
    acts = resolve_policy(policy)
    for _ in range(5):
        obs, *_ = env.step(acts(obs, env))
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    model.opt.timestep = env.sim.sim_config.physics_dt
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    data.qpos[0] = 0.5
    mujoco.mj_step(model, data, 5 * env.cfg.sim_steps_per_control)
    np.testing.assert_allclose(obs["robot"]["qpos"].numpy(), np.full((2, 1), data.qpos[0]), 1e-5)
    env.close()
