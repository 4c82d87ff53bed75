"""Configs made in Python are checked against the types of YAML, with key paths, at every door."""

import copy
import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs import BaseEnv, EnvCfg
from embodichain.lab.gym.envs.cfg import (
    EventCfg,
    GaussianNoiseCfg,
    NoiseCfg,
    ObservationCfg,
    RewardCfg,
    TerminationCfg,
    UniformNoiseCfg,
)
from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    AttachmentCfg,
    CollisionShapeCfg,
    ContactCfg,
    JointDrivePropertiesCfg,
    LightCfg,
    RenderCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.configs.self_collision_cfg import SelfCollisionCfg
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.sensors import CameraCfg, ContactSensorCfg, RaySensorCfg
from embodichain.lab.sim.shapes import CapsuleCfg, CubeCfg, CylinderCfg, ShapeCfg, SphereCfg
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import ConfigError
from tests.lab.gym.conftest import UR10


def small(**changes):
    """A task of one cube, without a file."""
    cfg = EnvCfg(
        sim_cfg=SimulationManagerCfg(headless=True, num_threads=1),
        objects={"cube": RigidObjectCfg(shape=CubeCfg(size=[0.1, 0.1, 0.1]))},
    )
    return dataclasses.replace(cfg, **changes)


def robot(**values):
    return RobotCfg(uid="ur10", fpath=UR10, **values)


def changed(path, value, cfg=None):
    """The small task, or a config, with one value set as a user sets it."""
    cfg = small(robot=robot()) if cfg is None else cfg
    node = cfg
    *parents, last = path.split(".")
    for part in parents:
        node = node[part] if isinstance(node, dict) else getattr(node, part)
    if isinstance(node, dict):
        node[last] = value
    else:
        setattr(node, last, value)
    return cfg


def report(make):
    with pytest.raises(ConfigError) as caught:
        make()
    return str(caught.value)


WRONG = {
    "robot.drive_pros.stiffness": ("soft", "expected a number or a map or 'file', got 'soft'"),
    "robot.drive_pros.drive_type": ("forse", "'none', got 'forse'. Did you mean 'force'?"),
    "robot.drive_pros.damping": (-1.0, "must not be negative, got -1.0"),
    "robot.drive_pros.armature": ({"Joint1": -0.5}, "Joint1: must not be negative, got -0.5"),
    "robot.init_pos": ((0.0, 1.0), "expected 3 values, got 2: [0.0, 1.0]"),
    "robot.attachments": (
        {"pad": AttachmentCfg(link="ee_link", shape=CylinderCfg(radius=-1.0))},
        "pad.shape.radius: must be positive metres, got -1.0",
    ),
    "robot.collision_shapes": (
        {"forearm_link": CollisionShapeCfg(shape=CapsuleCfg(height=0.0))},
        "forearm_link.shape.height: must be positive metres, got 0.0",
    ),
    "robot.contact": (
        {"ee_link": ContactCfg(solref=[0.1, -1.0])},
        "ee_link.solref: must be [time constant, damping ratio], both positive, or",
    ),
    "objects.cube.body_scale": ((1.0, 0.0, 1.0), "must be 3 positive numbers, got [1.0, 0.0, 1."),
    "robot.fix_base": ("yes", "expected true or false, got 'yes'"),
    "robot.self_collision": ({"exclude": []}, "must be a SelfCollisionCfg, got dict; SelfColl"),
    "objects.cube.body_type": ("dinamic", "'static', got 'dinamic'. Did you mean 'dynamic'?"),
    "objects.cube.shape": (ShapeCfg("Cub"), "shape_type: unknown shape 'Cub'; one of: Cube, "),
    "objects.cube.attrs.mass": ("1 kg", "expected a number, got '1 kg'"),
    "objects.ball": ({"shape": SphereCfg()}, "must be a RigidObjectCfg, got dict; RigidObjectC"),
    "lights.lamp": (LightCfg(light_type="lamp"), "light_type: expected one of 'point', 'sun', "),
    "sensors.touch": (SensorCfg("contcat"), "sensor 'contcat'; one of: camera, stereo_camera,"),
    "sensors.eye": (CameraCfg(data_types=["colour"]), "got 'colour'. Did you mean 'color'?"),
    "rewards.near": (RewardCfg("distance", weight="1"), "weight: expected a number, got '1'"),
    "terminations.far": (RewardCfg("distance"), "must be a TerminationCfg, got RewardCfg"),
    "events.move": (EventCfg("reset", mode="strtup"), "got 'strtup'. Did you mean 'startup'?"),
    "observations.q": (ObservationCfg("qpos", clip=[1.0]), "clip: expected 2 values, got 1: [1"),
    "observations.a": (
        ObservationCfg("qpos", noise={"std": 0.1}),
        "noise: must be a GaussianNoiseCfg, got dict; GaussianNoiseCfg.from_dict makes one",
    ),
    "observations.b": (
        ObservationCfg("qpos", noise=NoiseCfg(std=-0.1)),
        "noise.std: must not be negative, got -0.1",
    ),
    "observations.c": (
        ObservationCfg("qpos", noise=NoiseCfg("constant", bias=[float("nan")])),
        "noise.bias: must be finite",
    ),
    "num_envs": (True, "expected an integer, got true"),
    "max_episode_steps": (0, "must be at least 1, or -1 for no limit, got 0"),
    "seed": (0.5, "expected an integer, got 0.5"),
    "sim_cfg.physics_dt": (float("nan"), "expected a finite number, got nan"),
    "sim_cfg.render_cfg.renderer": ("fast", "got 'fast'. Did you mean 'fast-rt'?"),
    # Attributes that are not fields: Python sets them without a word.
    "robot.drive_pros.stifness": (3.0, "unknown key; allowed: drive_type, stiffness, dampin"),
    "max_episode_step": (3, "Did you mean 'max_episode_steps'?"),
}


@pytest.mark.parametrize("path", WRONG)
def test_a_wrong_value_names_its_key_and_what_is_allowed(path):
    value, message = WRONG[path]
    text = report(lambda: BaseEnv(changed(path, value)))
    assert text.startswith(path) and message in text
    assert "\n" not in text


def test_every_wrong_value_is_reported_at_once():
    cfg = small(robot=robot())
    for path in ("num_envs", "objects.cube.body_type", "robot.drive_pros.stifness"):
        changed(path, WRONG[path][0], cfg)
    text = report(lambda: BaseEnv(cfg))
    lines = text.splitlines()
    assert len(lines) == 3
    assert all(any(line.startswith(start) for line in lines) for start in ("num_envs", "objects"))


def test_a_task_that_is_no_config_is_refused():
    assert "must be an EnvCfg, got dict" in report(lambda: BaseEnv({"num_envs": 3}))


def test_a_simulation_checks_its_config():
    cfg = SimulationManagerCfg(headless="yes", num_envs=0, render_cfg=RenderCfg(renderer="fast"))
    text = report(lambda: SimulationManager(cfg))
    assert set(text.splitlines()) == {
        "render_cfg.renderer: expected one of 'hybrid', 'fast-rt', 'rt', 'auto', 'no-render', "
        "got 'fast'. Did you mean 'fast-rt'?",
        "headless: expected true or false, got 'yes'",
        "num_envs: must be at least 1, got 0",
    }


ADDED = {
    "add_robot": (
        robot(drive_pros=JointDrivePropertiesCfg(stiffness="soft")),
        "ur10.drive_pros.stiffness: expected a number or a map or 'file', got 'soft'",
    ),
    "add_articulation": (
        ArticulationCfg(uid="door", fpath=UR10, collision="hul"),
        "door.collision: expected one of 'hull', 'decompose', got 'hul'. Did you mean 'hull'?",
    ),
    "add_rigid_object": (
        RigidObjectCfg(uid="cube", attrs=RigidBodyAttributesCfg(mass="1")),
        "cube.attrs.mass: expected a number, got '1'",
    ),
    "add_light": (
        LightCfg(uid="lamp", cutoff=120.0),
        "lamp.cutoff: must be at most 90.0, got 120.0",
    ),
    "add_sensor": (
        RaySensorCfg(uid="scan", no_hit="maxx"),
        "scan.no_hit: expected one of 'max', 'inf', 'zero', got 'maxx'. Did you mean 'max'?",
    ),
}


@pytest.mark.parametrize("method", ADDED)
def test_what_is_added_to_a_simulation_is_checked(method):
    cfg, message = ADDED[method]
    sim = SimulationManager(SimulationManagerCfg(headless=True, num_threads=1))
    assert report(lambda: getattr(sim, method)(cfg)) == message
    kind = type(cfg).__name__
    as_dict = {"uid": "x", "sensor_type": "ray"}
    assert f"{kind}, got dict; {kind}.from_dict makes one" in report(
        lambda: getattr(sim, method)(as_dict)
    )


@configclass
class LabelledRobotCfg(RobotCfg):
    """A user's class with fields of its own."""

    label: object = None


class CountedObjectCfg(RigidObjectCfg):
    """A user's class that sets attributes."""

    def __init__(self, **values):
        super().__init__(**values)
        self.count = 3


def test_values_that_only_python_has_pass():
    def near(env, obs, action, info):
        return torch.zeros(env.num_envs)

    cfg = small(
        num_envs=np.int64(2),
        max_episode_steps=np.int32(7),
        robot=LabelledRobotCfg(
            uid="ur10",
            fpath=Path(UR10),
            label=object(),
            init_pos=torch.tensor([0.0, 0.0, 1.0]),
            init_qpos=np.zeros(6),
            drive_pros=JointDrivePropertiesCfg(stiffness=np.float32(1e3)),
            self_collision=SelfCollisionCfg(exclude=(["base_link", "forearm_link"],)),
        ),
        rewards={"near": RewardCfg(near, weight=np.float32(2.0))},
        terminations={"never": TerminationCfg(lambda env, obs, action, info: torch.zeros(2) > 1)},
        extensions={"table": np.arange(3), "video": np.zeros((2000, 1000))},
    )
    cfg.objects["cube"] = CountedObjectCfg(
        shape=CubeCfg(size=np.full(3, 0.1)), init_pos=np.array([0.5, 0.0, 1.0])
    )
    cfg.sensors["touch"] = ContactSensorCfg()
    cfg.sensors["touch"].entity_cfg.uid = "cube"
    env = BaseEnv(cfg)
    try:
        assert env.num_envs == 2 and env.max_episode_steps == 7
        assert isinstance(env.cfg.robot, LabelledRobotCfg)
        assert env.cfg.objects["cube"].count == 3
        env.reset()
        env.step(torch.zeros(2, 6))
    finally:
        env.close()


def test_the_check_changes_nothing_in_the_config():
    size = np.full(3, 0.1)
    cfg = small()
    cfg.objects["cube"].shape.size = size
    BaseEnv(cfg).close()
    assert cfg.objects["cube"].shape.size is size


def test_noise_is_a_config_of_its_kind():
    assert NoiseCfg(std=0.1) == GaussianNoiseCfg(std=0.1)
    assert NoiseCfg("uniform", low=0, n_max=1) == UniformNoiseCfg(low=0, n_max=1)
    assert NoiseCfg.from_dict({"std": 0.1}) == GaussianNoiseCfg(std=0.1)
    uniform = NoiseCfg("uniform", low=0, high=1)
    assert copy.deepcopy(uniform) == uniform.copy() == pickle.loads(pickle.dumps(uniform))


class LoudNoiseCfg(GaussianNoiseCfg):
    """A user's noise with a constructor of its own."""

    def __init__(self, decibels):
        super().__init__(std=10.0 ** (decibels / 20.0))


def test_noise_of_a_users_class():
    def zeros(env, obs):
        return torch.zeros(env.num_envs, 1)

    noise = LoudNoiseCfg(decibels=6)
    env = BaseEnv(small(observations={"a": ObservationCfg(zeros, noise=noise)}))
    assert env.cfg.observations["a"].noise.std == pytest.approx(1.995, abs=1e-3)
    env.close()


def test_a_key_of_another_kind_of_noise_names_those_of_this_kind():
    text = report(lambda: NoiseCfg(type="uniform", std=1.0))
    assert text == "std: unknown key; allowed: type, operation, low, high, n_min, n_max."
    text = report(lambda: GaussianNoiseCfg(sdt=1.0))
    assert text.startswith("sdt: unknown key; allowed: type, operation, mean, std. Did you mean")
    text = report(lambda: NoiseCfg(type="normal"))
    assert text.startswith("type: unknown type 'normal'; one of: gaussian, uniform, constant.")
