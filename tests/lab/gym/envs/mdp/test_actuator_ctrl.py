"""The action term of a file's own actuators, and the default action of MJCF robots."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import ActionTermCfg, EnvCfg, EventCfg
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg, SimulationManagerCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.mjcf_robots import ROBOTS, UR5E_HOME


@pytest.fixture
def make(tmp_path):
    """``make(name, actions=..., events=..., **robot)``: a task with a robot of `ROBOTS`."""
    envs = []

    def _make(name, actions=None, events=None, cls=BaseEnv, **robot):
        path = tmp_path / f"{name}.xml"
        path.write_text(ROBOTS[name])
        cfg = EnvCfg(num_envs=2, sim_cfg=SimulationManagerCfg(headless=True))
        cfg.robot = RobotCfg(uid="r", fpath=str(path), init_pos=(0, 0, 1), **robot)
        cfg.actions, cfg.events = actions or {}, events or {}
        envs.append(cls(cfg))
        return envs[-1]

    yield _make
    for env in envs:
        env.close()


def ctrl(**params):
    return ActionTermCfg(func="actuator_ctrl", params={"entity_cfg": {"uid": "r"}, **params})


def joint_position(**entity):
    return ActionTermCfg(func="joint_position", params={"entity_cfg": {"uid": "r", **entity}})


def step(env, row):
    env.step(torch.tensor(row, dtype=torch.float32).expand(env.num_envs, -1).contiguous())


def test_the_default_action_is_the_files_actuators(make):
    env = make("ur5e")
    assert env.action_manager.names == tuple(
        f"ctrl/{n}"
        for n in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    )
    assert env.single_action_space.low.tolist() == pytest.approx([-6.2831] * 6)
    assert np.allclose(env.action_manager.home(), UR5E_HOME)
    env.reset()
    step(env, [0.5] * 6)
    assert env.robot.get_ctrl().tolist() == [[0.5] * 6] * 2
    assert np.allclose(env.action_manager.hold(), 0.5)


def test_drives_come_after_the_files_actuators_one_column_each(make):
    pros = JointDrivePropertiesCfg(
        stiffness={"left_coupler_joint": 3.0}, damping={"left_coupler_joint": 0.1}
    )
    env = make("hand", drive_pros=pros)
    assert env.action_manager.names == ("ctrl/fingers", "ctrl/left_coupler_joint")
    assert env.single_action_space.low.tolist() == pytest.approx([0, -1.57])
    assert env.single_action_space.high.tolist() == pytest.approx([255, 1.57])
    env.reset()
    step(env, [100.0, 9.0])  # beyond its limit: clamped, as a drive's target is
    assert env.robot.read_ctrl()[0] == pytest.approx([100, 1.57])


def test_scale_offset_clip_and_choice_of_actuators(make):
    term = ctrl(
        actuator_names=["wrist_[12]", "elbow"],
        scale={"wrist_1": 2.0, ".*": 1.0},
        offset=0.5,
        clip=0.2,
    )
    env = make("ur5e", actions={"some": term})
    assert env.action_manager.names == ("some/elbow", "some/wrist_1", "some/wrist_2")
    assert env.action_manager.high.tolist() == pytest.approx([0.2] * 3)
    env.reset()
    step(env, [0.1, 0.1, 1.0])
    expected = [*UR5E_HOME[:2], 0.6, 0.7, 0.7, UR5E_HOME[5]]
    assert env.robot.read_ctrl()[1] == pytest.approx(expected)


def test_joint_actions_move_joints_whose_actuator_is_a_servo(make):
    wide = ctrl(actuator_names=["pull"])
    env = make("zoo", actions={"arm": joint_position(joint_names=["geared"]), "tendon": wide})
    env.reset()
    step(env, [0.5, 0.25])
    names = env.robot.actuator_names
    assert env.robot.read_ctrl()[0, names.index("geared_servo")] == 1.5
    assert env.robot.read_ctrl()[0, names.index("pull")] == 0.25


def test_randomized_gains_of_a_files_servo_are_the_joints(make):
    params = {
        "entity_cfg": {"uid": "r", "joint_names": ["geared"]},
        "stiffness_range": [2.0, 2.0],
        "operation": "scale",
    }
    event = EventCfg(func="randomize_actuator_gains", mode="reset", params=params)
    env = make("zoo", actions={"a": joint_position(joint_names=["geared"])}, events={"g": event})
    env.reset()
    servo = env.sim.engine.model.actuator("r/geared_servo").id
    gains = env.sim.engine.model_field("actuator_gainprm").reshape(2, -1, 10)
    assert gains[:, servo, 0].tolist() == [14.0, 14.0]
    joint = env.robot.joint_names.index("geared")
    assert env.robot.drives.stiffness[:, joint].tolist() == [126.0, 126.0]


def test_targets_of_servos_keep_to_the_drives_max_velocity(make):
    env = make("ur5e", drive_pros=JointDrivePropertiesCfg(max_velocity=0.5))
    env.reset()
    step(env, [*UR5E_HOME[:2], 3.0, *UR5E_HOME[3:]])
    assert env.robot.read_ctrl()[:, 2] == pytest.approx(UR5E_HOME[2] + 0.5 * env.step_dt)


class OwnJoints(BaseEnv):
    """A task class that says which joints it acts on, as EmbodiChain's do."""

    active_joint_ids = [2, 3]


def test_a_class_that_picks_joints_is_given_joint_targets(make):
    env = make("ur5e", cls=OwnJoints)
    assert len(env.action_manager) == 0 and env.single_action_space.shape == (2,)
    env.reset()
    step(env, [0.1, 0.2])
    assert env.robot.read_ctrl()[0, 2:4] == pytest.approx([0.1, 0.2])


@pytest.mark.parametrize(
    ("name", "actions", "message"),
    [
        (
            "zoo",
            {},
            "actions.ctrl.params.clip: actuators without a ctrlrange: wrist.qw, wrist.qx, "
            "wrist.qy, wrist.qz, brake, lag, pid.pos, pid.vel, walk, dc; give the bounds of the "
            "action, as in actions: {ctrl: {func: actuator_ctrl, params: {of: {uid: r}, "
            "clip: [-1, 1]}}}, or clip: {NAME: [-1, 1], ...}",
        ),
        (
            "ur5e",
            {"a": ctrl(actuator_names=["elbo"])},
            "actions.a.params.actuator_names: no actuator matches 'elbo'; there are: shoulder_pan, "
            "shoulder_lift, elbow, wrist_1, wrist_2, wrist_3 Did you mean 'elbow'?",
        ),
        (
            "ur5e",
            {"a": ctrl(scale={"elbo": 2.0})},
            "actions.a.params.scale.elbo: no actuator of this term matches 'elbo'; there are: "
            "shoulder_pan, shoulder_lift, elbow, wrist_1, wrist_2, wrist_3 Did you mean 'elbow'?",
        ),
        (
            "ur5e",
            {
                "a": ActionTermCfg(
                    func="actuator_ctrl",
                    params={"entity_cfg": {"uid": "r", "joint_names": ["elbow_joint"]}},
                )
            },
            "actions.a.params.entity_cfg: picks joints; this term picks actuators: actuator_names",
        ),
    ],
)
def test_what_is_wrong_is_said(make, name, actions, message):
    with pytest.raises(ConfigError) as raised:
        make(name, actions=actions)
    assert str(raised.value) == message


def test_a_position_action_of_a_velocity_servo_is_an_error(make):
    with pytest.raises(ConfigError, match="'spun' take velocity targets only: use joint_velocity"):
        make("zoo", actions={"a": joint_position(joint_names=["spun"])})
