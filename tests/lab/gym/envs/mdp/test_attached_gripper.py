"""The gripper of this package on an arm: widths, speed, force, a cube held and released."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import ActionTermCfg, EnvCfg, ObservationCfg, PhysicsTaskCfg
from embodichain.lab.sim.cfg import (
    AttachedFileCfg,
    JointDrivePropertiesCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.sensors import ContactSensorCfg, LinksCfg
from embodichain.lab.sim.shapes import CubeCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.mjcf_robots import HAND
from tests.lab.sim.compiler.helpers import GRIPPER_URDF, write

SHIPPED = "ParallelGripper/parallel_gripper.xml"
DOWN = [0, -1.2, 1.9, -2.27, -1.57, 0]  # the tool at (0.775, 0.1641, 0.1037), pointing down
FINGERS = ["gripper/left_finger", "gripper/right_finger"]
WIDTH = {"actuator_names": "gripper/grip", "width": [0, 0.085]}


@pytest.fixture
def make():
    built = []

    def build(fpath=SHIPPED, of=None, observations=None, sensors=None, objects=None, **params):
        robot = RobotCfg(
            uid="ur10",
            fpath="UniversalRobots/UR10/UR10.urdf",
            init_qpos=DOWN,
            gravcomp=1.0,
            drive_pros=JointDrivePropertiesCfg(
                stiffness={"Joint.": 2000}, damping={"Joint.": 200}, max_effort="file"
            ),
            attach={"gripper": AttachedFileCfg(fpath=fpath, to="ee_link")},
        )
        arm = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint."}}
        grip = {"entity_cfg": {"uid": "ur10", **(of or {})}, **params}
        cfg = EnvCfg(
            num_envs=2,
            sim_cfg=SimulationManagerCfg(headless=True),
            physics=PhysicsTaskCfg(physics_dt=0.005, cone="elliptic", impratio=10),
            robot=robot,
            objects=objects or {},
            sensors=sensors or {},
            actions={
                "arm": ActionTermCfg(func="joint_position", params=arm),
                "grip": ActionTermCfg(func="parallel_gripper", params=grip),
            },
            observations=observations or {},
        )
        env = BaseEnv(cfg)
        built.append(env)
        env.reset()
        return env

    yield build
    for env in built:
        env.close()


def step(env, grip, count=1, arm=(0.0,) * 6):
    action = np.concatenate([np.asarray(DOWN) + arm, [grip]])
    for _ in range(count):
        obs, *_ = env.step(torch.tensor(action, dtype=torch.float32).repeat(2, 1))
    return obs


def opening():
    ends = [{"uid": "ur10", "link_names": [finger]} for finger in FINGERS]
    params = {"source_entity_cfg": ends[0], "target_entity_cfg": ends[1]}
    return ObservationCfg(func="gripper_opening", params=params)


def test_widths_and_speed(make):
    env = make(observations={"opening": opening()}, speed=0.15, **WIDTH)
    assert env.single_action_space.low[6] == 0
    assert env.single_action_space.high[6] == pytest.approx(0.085)
    assert env.action_manager.home()[6] == pytest.approx(0.085)  # the file's keyframe is open
    widths = [step(env, 0.03)["opening"][0].item() for _ in range(20)]
    speeds = -np.diff(widths) / env.step_dt
    assert speeds.max() < 0.15 * 1.4  # the servo swings a little about the moving target
    assert speeds[4:12].mean() == pytest.approx(0.15, rel=0.1)
    obs = step(env, 0.03, 30)
    assert obs["opening"].tolist() == pytest.approx(np.full((2, 1), 0.03), abs=1e-4)
    left, right = (env.robot.parsed.joint_names.index(f"gripper/{n}") for n in ("left", "right"))
    qpos = env.robot.read_qpos()
    assert np.abs(qpos[:, left] - qpos[:, right]).max() < 1e-5
    assert env.action_manager.hold()[0, 6] == pytest.approx(0.03)


def test_a_cube_is_held_shaken_and_released(make):
    at = [0.775, 0.1641, 0.1035]
    env = make(
        objects={
            "cube": RigidObjectCfg(
                shape=CubeCfg(size=[0.05] * 3), attrs=RigidBodyAttributesCfg(mass=0.5), init_pos=at
            ),
            "stand": RigidObjectCfg(
                shape=CubeCfg(size=[0.1, 0.1, 0.0785]),
                body_type="static",
                init_pos=[*at[:2], 0.0785 / 2],
            ),
        },
        sensors={
            "fingers": ContactSensorCfg(
                entity_cfg=LinksCfg(uid="ur10", link_names=FINGERS), against=LinksCfg(uid="cube")
            )
        },
        observations={
            "opening": opening(),
            "grasped": ObservationCfg(func="grasped", params={"sensor": "fingers"}),
        },
        force=60.0,
        **WIDTH,
    )
    assert not step(env, 0.085, 3)["grasped"].any()
    obs = step(env, 0.0, 50)
    assert obs["grasped"].all()
    assert obs["opening"][0].item() == pytest.approx(0.05, abs=1e-3)  # the pads give way
    force = env.sim.get_sensor("fingers").read_force()
    np.testing.assert_allclose(np.linalg.norm(force, axis=-1), 60, atol=1.5)

    cube, robot = env.sim.get_rigid_object("cube"), env.robot

    def held_at():
        """The cube in the tool's frame: unchanged while it does not slip."""
        tool = robot.get_link_pose("gripper/tcp", to_matrix=True)
        return (torch.linalg.inv(tool) @ cube.get_local_pose(to_matrix=True))[:, :3, 3]

    up = np.array([0, -0.25, 0, 0.25, 0, 0])
    for k in range(25):
        step(env, 0.0, arm=up * (k + 1) / 25)
    step(env, 0.0, 20, arm=up)
    before = held_at()
    step(env, 0.0, 25, arm=up)
    assert (held_at() - before).norm(dim=1).max() < 1e-4  # no creep in half a second
    for k in range(40):  # swung by up to 8 m/s^2: friction has no memory, the cube drifts a little
        swing = 0.1 * np.sin(0.2 * k) * np.array([1, 0, 0, 0, 2, 0])
        assert step(env, 0.0, arm=up + swing)["grasped"].all()
    step(env, 0.0, 20, arm=up)
    assert cube.get_local_pose()[:, 2].min() > 0.25
    assert (held_at() - before).norm(dim=1).max() < 3e-3
    obs = step(env, 0.085, 40, arm=up)
    assert not obs["grasped"].any()
    assert obs["opening"][0].item() == pytest.approx(0.085, abs=1e-3)
    assert cube.get_local_pose()[:, 2].max() < 0.15  # it fell


def test_a_urdf_gripper_whose_fingers_mimic(make, tmp_path):
    path = write(tmp_path / "gripper.urdf", GRIPPER_URDF)
    joint = {"joint_names": "gripper/slide_left"}
    env = make(path, joint, lower_command=0.0, upper_command=0.2, width=[0.1, 0.7])
    assert env.action_manager.names[-1] == "grip/gripper"
    step(env, 0.4, 100)
    left, right = env.robot.read_qpos()[0, 6:]
    assert left == pytest.approx(0.1, abs=2e-3)
    assert right == pytest.approx(-2 * left + 0.1, abs=1e-3)


def test_binary_with_a_tendon_that_closes_at_its_upper_end(make, tmp_path):
    path = write(tmp_path / "hand.xml", HAND)
    commands = {"open_command": 0.0, "close_command": 255.0, "force": 2.0}
    env = make(path, actuator_names="gripper/.*", command_mode="binary", **commands)
    which = env.robot.parsed.control_names.index("gripper/fingers")
    step(env, -1.0)
    # 2 N are 2 / 0.3137255 units of ctrl ahead of the tendon, which starts at length 0.
    assert env.robot.read_ctrl()[0, which] == pytest.approx(2 / 0.3137255)
    step(env, 1.0)
    length = 0.5 * env.robot.read_qpos()[0, [6, 10]].sum()
    assert length > 0
    assert env.robot.read_ctrl()[0, which] == 0


@pytest.mark.parametrize(
    ("params", "key", "part"),
    [
        ({"actuator_names": "gripper/gripp"}, "actuator_names", "gripper/grip"),
        ({"actuator_names": "gripper/grip", "width": [0.1, 0.1]}, "width", "the same"),
        (
            {**WIDTH, "command_mode": "binary", "open_command": 0.085, "close_command": 0},
            "width",
            "no meaning in mode binary",
        ),
    ],
)
def test_wrong_parameters(make, params, key, part):
    with pytest.raises(ConfigError, match=part) as caught:
        make(**params)
    assert caught.value.problems[0].path == f"actions.grip.params.{key}"


def test_force_needs_a_servo(make, tmp_path):
    motor = HAND.replace('biastype="affine"', "").replace('biasprm="0 -100 -10"', "")
    path = write(tmp_path / "hand.xml", motor)
    with pytest.raises(ConfigError, match="'gripper/fingers' is not a position servo"):
        make(path, actuator_names="gripper/.*", force=2.0)


def test_grasped_needs_two_fingers(make):
    sensor = ContactSensorCfg(entity_cfg=LinksCfg(uid="ur10", link_names=FINGERS[:1]))
    with pytest.raises(ConfigError, match="on two fingers; it is on gripper/left_finger"):
        make(
            sensors={"thumb": sensor},
            observations={"g": ObservationCfg(func="grasped", params={"sensor": "thumb"})},
            **WIDTH,
        )
