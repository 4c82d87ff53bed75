"""Tasks declared in Python in EmbodiChain's form: what a gym config with the same content is."""

import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from embodichain.compat.gym_config.env_cfg import config_to_cfg
from embodichain.lab.gym.envs import EmbodiedEnv, EmbodiedEnvCfg
from embodichain.lab.gym.envs.cfg import SceneEntityCfg
from embodichain.lab.gym.utils.registration import register_env
from embodichain.lab.sim.cfg import LightCfg, RigidBodyAttributesCfg, RigidObjectCfg, RobotCfg
from embodichain.lab.sim.sensors import CameraCfg, ContactSensorCfg, LinksCfg, StereoCameraCfg
from embodichain.lab.sim.shapes import CapsuleCfg, CubeCfg
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import ConfigError

from embodichain.compat.functor_cfgs import (  # isort: skip  (where `managers` has them from)
    ActionTermCfg,
    DatasetFunctorCfg,
    EventCfg,
    ObservationCfg,
    RewardCfg,
)

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "tutorials" / "gym" / "modular_env.py"
HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]


def lifted(env, obs, action, info, entity_cfg):
    """A reward of the user's own."""
    return env.sim.get_rigid_object(entity_cfg.uid).get_local_pose()[:, 2]


@configclass
class Events:
    mass: EventCfg = EventCfg(
        func="randomize_rigid_object_mass",
        params={"entity_cfg": SceneEntityCfg(uid="cube"), "mass_range": (0.5, 2.0)},
    )
    unused: EventCfg | None = None


@configclass
class Observations:
    qpos: ObservationCfg = ObservationCfg(
        func="normalize_robot_joint_data", name="robot/qpos", params={"joint_ids": [0, 1]}
    )
    mass: ObservationCfg = ObservationCfg(
        func="get_rigid_object_physics_attributes",
        mode="add",
        name="mass",
        params={"entity_cfg": SceneEntityCfg(uid="cube"), "attributes": ["mass"]},
    )


class Rewards:
    """A plain class, as people write it too."""

    height = RewardCfg(func="joint_limit_penalty", weight=0.5, params={"robot_uid": "arm"})


class Actions:
    arm = ActionTermCfg(func="DeltaQposTerm", params={"scale": 0.1})


@configclass
class Cfg(EmbodiedEnvCfg):
    robot: RobotCfg = RobotCfg(uid="arm", fpath="UniversalRobots/UR10/UR10.urdf", init_qpos=HOME)
    light: EmbodiedEnvCfg.EnvLightCfg = EmbodiedEnvCfg.EnvLightCfg(
        direct=[LightCfg(uid="lamp", init_pos=(0, 0, 2))]
    )
    background: list[RigidObjectCfg] = [
        RigidObjectCfg(uid="table", shape=CubeCfg(size=[0.5, 0.5, 0.4]), init_pos=(0.9, 0, 0.2))
    ]
    rigid_object: list[RigidObjectCfg] = [
        RigidObjectCfg(
            uid="cube",
            shape=CubeCfg(size=[0.06] * 3),
            # A gym config has EmbodiChain's default, a Python class 0.
            attrs=RigidBodyAttributesCfg(linear_damping=0.7, angular_damping=0.7),
            init_pos=(0.9, 0, 0.43),
        )
    ]
    events: object = Events()
    observations: object = Observations()
    rewards: object = Rewards()
    actions: object = Actions()
    extensions: object = {"success_threshold": 0.1}
    goal_height: float = 0.7


GYM_CONFIG = {
    "id": "EmbodiedEnv-v1",
    "num_envs": 2,
    "robot": {"uid": "arm", "fpath": "UniversalRobots/UR10/UR10.urdf", "init_qpos": HOME},
    "light": {"direct": [{"uid": "lamp", "init_pos": [0, 0, 2]}]},
    "background": [
        {
            "uid": "table",
            "shape": {"shape_type": "Cube", "size": [0.5, 0.5, 0.4]},
            "init_pos": [0.9, 0, 0.2],
        }
    ],
    "rigid_object": [
        {
            "uid": "cube",
            "shape": {"shape_type": "Cube", "size": [0.06, 0.06, 0.06]},
            "init_pos": [0.9, 0, 0.43],
        }
    ],
    "env": {
        "events": {
            "mass": {
                "func": "randomize_rigid_object_mass",
                "params": {"entity_cfg": {"uid": "cube"}, "mass_range": [0.5, 2.0]},
            }
        },
        "observations": {
            "qpos": {
                "func": "normalize_robot_joint_data",
                "name": "robot/qpos",
                "params": {"joint_ids": [0, 1]},
            },
            "mass": {
                "func": "get_rigid_object_physics_attributes",
                "mode": "add",
                "name": "mass",
                "params": {"entity_cfg": {"uid": "cube"}, "attributes": ["mass"]},
            },
        },
        "rewards": {
            "height": {
                "func": "joint_limit_penalty",
                "weight": 0.5,
                "params": {"robot_uid": "arm"},
            }
        },
        "actions": {"arm": {"func": "DeltaQposTerm", "params": {"scale": 0.1}}},
        "extensions": {"success_threshold": 0.1},
    },
}


@pytest.fixture
def build():
    made = []

    def _build(cfg, **kwargs):
        made.append(EmbodiedEnv(cfg, **kwargs))
        return made[-1]

    yield _build
    for env in made:
        env.close()


def _played(env):
    """Ten steps from one seed: observations, rewards and states."""
    obs, _ = env.reset(seed=3)
    seen = [obs["robot"]["qpos"].clone(), obs["mass"].clone()]
    for step in range(10):
        action = torch.full((2, 6), 0.1 * (step % 3))
        obs, reward, *_ = env.step(action)
        seen += [obs["robot"]["qpos"].clone(), reward]
    return [*seen, torch.as_tensor(env.sim.engine.rows.copy())]


def test_the_same_declared_in_python_and_in_a_file_plays_the_same(build):
    declared, read = build(Cfg(num_envs=2)), build(config_to_cfg(GYM_CONFIG))
    assert declared.cfg.objects["table"].body_type == "static", "a background's default"
    assert declared.success_threshold == 0.1
    for one, other in zip(_played(declared), _played(read), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_what_the_config_declares_stays_readable_and_builds_again(build):
    env = build(Cfg(num_envs=2))
    assert env.cfg.goal_height == 0.7 and env.cfg.rigid_object[0].uid == "cube"
    again = build(env.cfg)
    assert again.sim.asset_uids == env.sim.asset_uids
    for one, other in zip(_played(env), _played(again), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_the_users_config_is_left_as_it_is(build):
    cfg = Cfg()
    build(cfg)
    assert cfg.objects == {} and isinstance(cfg.events, Events)


def test_ours_and_theirs_together(build):
    cfg = Cfg(
        sensor=[ContactSensorCfg(uid="touch", entity_cfg=LinksCfg(uid="cube"))],
        objects={"post": RigidObjectCfg(shape=CapsuleCfg(), init_pos=(3, 0, 1))},
        rewards={"lift": RewardCfg(func=lifted, params={"entity_cfg": SceneEntityCfg(uid="cube")})},
    )
    cfg.rigid_object.append(RigidObjectCfg(uid="pill", shape=CapsuleCfg(), init_pos=(5, 0, 1)))
    cfg.robot.drive_pros.armature = 0.25
    env = build(cfg)
    assert {"post", "pill", "cube", "table", "touch", "lamp"} <= set(env.sim.asset_uids)
    assert env.robot.body_data.joint_armature[0, 0] == 0.25
    env.reset()
    *_, info = env.step(torch.zeros(1, 6))
    assert info["rewards"]["lift"].item() == pytest.approx(0.43, abs=1e-3)


def test_a_function_of_the_users_own_is_a_functor(build):
    def height(env, obs, action, info):
        return env.sim.get_rigid_object("cube").get_local_pose()[:, 2]

    env = build(Cfg(rewards={"height": RewardCfg(func=height, weight=2.0)}))
    env.reset()
    *_, info = env.step(torch.zeros(1, 6))
    assert info["rewards"]["height"].item() == pytest.approx(0.43, abs=1e-3)


@pytest.mark.parametrize("camera", [CameraCfg, StereoCameraCfg])
def test_a_camera_is_observed_in_its_axes(build, camera):
    pose = camera.ExtrinsicsCfg(parent="ee_link", pos=(0.1, 0.0, 0.0))
    here = camera.ExtrinsicsCfg(pos=(0.0, 0.0, 2.0))
    small = {"width": 8, "height": 6}
    env = build(
        Cfg(
            sensor=[
                camera(uid="hand", extrinsics=pose, **small),
                camera(uid="fixed", extrinsics=here, **small),
            ]
        )
    )
    obs, _ = env.reset()
    assert obs["sensor"]["hand"]["color"].shape == (1, 6, 8, 4)
    link = env.robot.get_link_pose("ee_link", to_matrix=True)
    point = torch.tensor([0.1, 0.0, 0.0, 1.0])
    torch.testing.assert_close(
        env.get_sensor("hand").get_arena_pose(to_matrix=True)[0, :, 3], link[0] @ point
    )
    # EmbodiChain: along z, and it is the sky above.
    down = env.get_sensor("fixed").get_arena_pose(to_matrix=True)[0, :3, :3]
    torch.testing.assert_close(down, torch.diag(torch.tensor([1.0, -1.0, -1.0])))


def test_what_means_nothing_here_is_said_once_by_name(build, caplog):
    cfg = Cfg(
        filter_dataset_saving=True,
        dataset={"lerobot": DatasetFunctorCfg()},
        rigid_object=[
            RigidObjectCfg(
                uid="cube",
                attrs=RigidBodyAttributesCfg(static_friction=0.9, mass=2.0),
                init_pos=(0.9, 0, 1.5),
            )
        ],
    )
    with caplog.at_level(logging.WARNING):
        build(cfg)
    told = [r.getMessage().partition(":")[0] for r in caplog.records]
    assert [m for m in told if m in ("rigid_object.0.attrs.static_friction", "dataset")] == [
        "rigid_object.0.attrs.static_friction",
        "dataset",
    ]
    assert not any("mass" in m or "mode" in m for m in told), told


def test_mistakes_name_the_place_in_the_config():
    cfg = Cfg(
        events={"push": EventCfg(func="randomize_rigid_object_mas")},
        background=[RigidObjectCfg(uid="table"), RigidObjectCfg(uid="table")],
    )
    with pytest.raises(ConfigError, match=r"background\.1\.uid.*called 'table' already"):
        EmbodiedEnv(cfg)
    cfg.background.pop()
    with pytest.raises(ConfigError, match=r"events\.push\.func.*randomize_rigid_object_mass"):
        EmbodiedEnv(cfg)


def test_a_registered_class_takes_it(build):
    import gymnasium as gym

    @register_env("EmbodiedCfgTest-v0", max_episode_steps=7, override=True)
    class Task(EmbodiedEnv):
        pass

    env = gym.make("EmbodiedCfgTest-v0", cfg=Cfg(num_envs=2))
    assert env.unwrapped.max_episode_steps == 7 and env.action_space.shape == (2, 6)
    np.testing.assert_array_equal(env.unwrapped.single_action_space.high, 1.0)
    env.close()


@pytest.mark.unmeasured
def test_the_tutorials_script_runs():
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--headless", "--num_envs", "2"],
        env={**env, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("cube at") == 2 and done.stderr == ""
