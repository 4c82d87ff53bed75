"""A compiled scene is a value of its own: environments share it, and none writes to it."""

import dataclasses
import hashlib

import mujoco
import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import EnvCfg, EventCfg, PhysicsTaskCfg
from embodichain.lab.gym.envs.scene_setup import declared_scene
from embodichain.lab.gym.envs.scene_setup.declared_scene import describe
from embodichain.lab.gym.utils.registration import config_declares_scene, register_env
from embodichain.lab.sim import scene as scene_module
from embodichain.lab.sim.cfg import (
    JointDrivePropertiesCfg,
    LightCfg,
    RigidObjectCfg,
    RobotCfg,
)
from embodichain.lab.sim.compiler.robot import articulation
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.learning.checkpoints.physics_values import physics_values
from embodichain.recording import McapRecorder
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.helpers import GRIPPER_URDF, HOME, UR10, write

MASS = {"entity_cfg": {"uid": "ur10"}, "mass_range": [0.5, 2.0], "relative": True}


def task(**changes):
    """An arm above a cube and a lamp."""
    drives = JointDrivePropertiesCfg(stiffness=500, damping=50, max_effort="file")
    cfg = EnvCfg(
        num_envs=2,
        seed=3,
        robot=RobotCfg(uid="ur10", fpath=UR10, init_qpos=HOME, drive_pros=drives),
        objects={"cube": RigidObjectCfg(shape=CubeCfg(size=[0.1, 0.1, 0.1]), init_pos=(1, 0, 0.3))},
        lights={"lamp": LightCfg(init_pos=(0, 0, 3))},
        physics=PhysicsTaskCfg(physics_dt=0.005, gravity=[0, 0, -3.7]),
    )
    return cfg.replace(**changes)


def event(func, **params):
    return EventCfg(func, params=params, mode="reset")


RANDOM = {
    "arm": event(
        "randomize",
        of={"uid": "ur10"},
        mass=[0.5, 2.0],
        stiffness=[0.5, 2.0],
        damping=[0.5, 2.0],
        armature=[0.5, 2.0],
        joint_friction=[0.5, 2.0],
        operation="scale",
    ),
    "com": event("randomize", of={"uid": "ur10"}, com=[[-0.01] * 3, [0.01] * 3]),
    "cube": event(
        "randomize", of={"uid": "cube"}, scale=[0.5, 1.5], mass=[1.0, 3.0], friction=[0.2, 1.0]
    ),
    "gravity": event("randomize", gravity=[[0, 0, -1], [0, 0, 1]]),
    "colour": event(
        "randomize_visual_material",
        entity_cfg={"uid": "cube"},
        base_color_range=[[0.0] * 3, [1.0] * 3],
    ),
    "light": event("randomize_light", entity_cfg={"uid": "lamp"}, intensity_range=[1, 9]),
    "place": event("randomize_pose", of={"uid": "cube"}, position_range=[[0, 0, 0], [0.2, 0, 0]]),
}


def digest(value, seen=None):
    """A digest of everything in a compiled scene: models, specs, arrays, configs."""
    if isinstance(value, mujoco.MjModel):
        data = np.zeros(mujoco.mj_sizeModel(value), np.uint8)
        mujoco.mj_saveModel(value, None, data)
        return hashlib.sha256(data.tobytes()).hexdigest()
    if isinstance(value, mujoco.MjSpec):
        return value.to_xml()
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    if dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        return tuple((field.name, digest(getattr(value, field.name))) for field in fields)
    if isinstance(value, dict):
        return tuple((key, digest(item)) for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return tuple(map(digest, value))
    return repr(value)


def rollout(env, steps=5):
    """Rows of all environments after each of some steps with actions from a fixed sequence."""
    env.reset()
    generator = torch.Generator().manual_seed(5)
    rows = [env.sim.engine.rows.copy()]
    for _ in range(steps):
        env.step(torch.rand(env.action_space.shape, generator=generator) - 0.5)
        rows.append(env.sim.engine.rows.copy())
    return np.array(rows)


@pytest.fixture
def reading(monkeypatch):
    """Counts the files that are read and the scenes that are compiled."""
    counts = {"files": 0, "scenes": 0}

    def counted(name, function):
        def call(*args, **kwargs):
            counts[name] += 1
            return function(*args, **kwargs)

        return call

    for module in (declared_scene, scene_module):
        # Counts calls, which nothing else tells but the time.
        monkeypatch.setattr(module, "compile_scene", counted("scenes", module.compile_scene))
    read = counted("files", articulation.read_robot)
    # Counted like the calls above.
    monkeypatch.setattr(articulation, "read_robot", read)
    return counts


def test_environments_of_a_compiled_scene_read_and_compile_nothing(reading):
    scene = describe(task()).compile()
    assert reading == {"files": 1, "scenes": 1}
    model = scene.model
    assert model.opt.timestep == 0.005  # the task's own physics
    assert model.opt.gravity.tolist() == [0.0, 0.0, -3.7]
    envs = [BaseEnv(task(num_envs=n), compiled_scene=scene) for n in (1, 3)]
    assert reading == {"files": 1, "scenes": 1}
    alone = BaseEnv(task())
    assert reading == {"files": 2, "scenes": 2}
    assert physics_values(alone.sim.scene.model) == physics_values(model)
    for env in (*envs, alone):
        env.close()


def test_environments_of_one_scene_do_not_disturb_each_other_or_the_scene(tmp_path):
    cfg = task(events=RANDOM)
    alone = BaseEnv(cfg)
    expected = rollout(alone)
    alone.close()
    scene = describe(cfg).compile()
    before = digest(scene)
    first = BaseEnv(cfg.replace(seed=9), compiled_scene=scene)
    first.add_observer(McapRecorder(tmp_path / "first.mcap", first))
    second = BaseEnv(cfg, compiled_scene=scene)
    rows = rollout(first)
    first.robot.set_joint_drive(stiffness=torch.full((2, 6), 9.0))
    first.sim.get_rigid_object("cube").set_mass(torch.tensor([7.0, 8.0]))
    assert (rollout(second) == expected).all()
    assert not (rows == expected).all()
    first.close()  # the second one goes on
    assert (rollout(second) != 0).any()
    second.close()
    assert digest(scene) == before
    with pytest.raises(ValueError, match="read-only"):
        scene.initial_row[0] = 1.0
    third = BaseEnv(cfg, compiled_scene=scene)
    assert (rollout(third) == expected).all()
    third.close()


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"physics": PhysicsTaskCfg(physics_dt=0.004)}, "physics"),
        ({"lights": {}}, "lamp"),
        ({"objects": {}}, "cube"),
        ({"robot": task().robot.replace(init_pos=(0, 0, 2))}, "ur10"),
        ({"robot": task().robot.replace(uid="ur5")}, "ur10"),
    ],
)
def test_a_scene_of_another_config_is_refused_and_the_difference_named(changes, name):
    scene = describe(task()).compile()
    with pytest.raises(ValueError, match=f"another config; these differ: .*{name}"):
        BaseEnv(task(**changes), compiled_scene=scene)


def test_the_scene_of_a_config_with_mistakes_is_not_compiled():
    declared = describe(task(lights={"cube": LightCfg()}))
    assert declared.parts is None
    with pytest.raises(ConfigError, match=r"lights\.cube: uid 'cube' is taken by objects\.cube"):
        declared.compile()


def test_armature_that_was_added_may_be_given_by_the_config():
    arm = JointDrivePropertiesCfg(stiffness=1e4, damping=1e3, max_effort="file")
    cfg = task(robot=task().robot.replace(drive_pros=arm))
    declared = describe(cfg)
    added = declared.added_armature()
    assert list(added) == ["robot"]
    assert len(added["robot"]) > 1
    given = declared.with_given_armature()
    assert given.added_armature() == {}
    frozen = cfg.copy()
    frozen.robot.drive_pros.armature = added["robot"]
    env = BaseEnv(frozen, compiled_scene=given.compile())
    other = BaseEnv(cfg)
    assert physics_values(env.sim.scene.model) == physics_values(other.sim.scene.model)
    env.close()
    other.close()


def test_a_file_that_was_written_since_is_read_anew(tmp_path):
    name = write(tmp_path / "g.urdf", GRIPPER_URDF)
    cfg = EnvCfg(robot=RobotCfg(fpath=name))
    first = describe(cfg).compile()
    write(tmp_path / "g.urdf", GRIPPER_URDF.replace("slide_left", "slide_on_the_left"))
    assert describe(cfg).compile().model.joint("g/slide_on_the_left").name
    assert first.model.joint("g/slide_left").name


def test_a_config_is_pure_data():
    cfg = task()
    env = BaseEnv(cfg, compiled_scene=describe(cfg).compile())
    for config in (env.cfg.sim_cfg, env.sim.sim_config):
        assert vars(config).keys() == {field.name for field in dataclasses.fields(config)}
    env.close()


# -- classes ---------------------------------------------------------------------------------------


class Rewarding(BaseEnv):
    """Adds no entity."""

    def get_reward(self, obs, action, info):
        return torch.ones(self.num_envs)


class WithATable(BaseEnv):
    """Adds an entity in a hook."""

    def _prepare_scene(self, **kwargs):
        super()._prepare_scene(**kwargs)
        self.sim.add_rigid_object(RigidObjectCfg(uid="extra", body_type="static"))


class WithACfg(BaseEnv):
    """May change its config before it is built."""

    def __init__(self, cfg=None, **kwargs):
        super().__init__(cfg, **kwargs)


@pytest.mark.parametrize(
    ("cls", "alone"), [(BaseEnv, True), (Rewarding, True), (WithATable, False), (WithACfg, False)]
)
def test_a_class_that_may_add_entities_is_compiled_inside_the_build(cls, alone):
    name = f"{cls.__name__}-of-compiled-scenes-v0"
    register_env(name, override=True)(cls)
    assert config_declares_scene(name) is alone


def test_a_function_that_makes_environments_is_compiled_inside_the_build():
    register_env("made-by-a-function-v0", override=True)(lambda **kwargs: BaseEnv(**kwargs))
    assert not config_declares_scene("made-by-a-function-v0")


def test_a_class_that_adds_entities_refuses_the_scene_of_its_config():
    with pytest.raises(ValueError, match="these differ: extra"):
        WithATable(task(), compiled_scene=describe(task()).compile())
