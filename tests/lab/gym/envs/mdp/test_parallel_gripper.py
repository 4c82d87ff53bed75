"""The parallel gripper: one number for two fingers of a small hand."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.utils.errors import ConfigError

HAND = """<mujoco><worldbody><body name="palm"><geom size=".05" mass="1"/>
  <body name="left" pos="0 .05 0"><joint name="finger_left" type="slide" axis="0 1 0"
    range="0 0.04"/><geom size=".01" mass="0.1"/></body>
  <body name="right" pos="0 -.05 0"><joint name="finger_right" type="slide" axis="0 -1 0"
    range="0 0.03"/><geom size=".01" mass="0.1"/></body>
  <body name="wheel" pos=".1 0 0"><joint name="wheel" axis="0 0 1"/>
    <geom size=".01" mass="0.1"/></body>
</body></worldbody></mujoco>"""


@pytest.fixture
def hand(make, tmp_path):
    """Builds the hand with a gripper action of these parameters."""
    path = tmp_path / "hand.xml"
    path.write_text(HAND)

    def build(joints: str = "finger_.*", **params):
        drives = JointDrivePropertiesCfg(stiffness=1e4, damping=1e3)
        qpos = [0.01, 0.01, 0.0]
        robot = RobotCfg(uid="hand", fpath=str(path), init_qpos=qpos, drive_pros=drives)
        entity = {"uid": "hand", "joint_names": joints}
        term = ActionTermCfg(func="parallel_gripper", params={"entity_cfg": entity, **params})
        env = make(robot=robot, objects={}, actions={"grip": term})
        env.reset()
        return env

    return build


def moved(env, value: float) -> list[float]:
    """Targets of the two fingers in the last environment."""
    env.step(torch.full((3, 1), value))
    return env.robot.drives.read_target_qpos()[2, :2].tolist()


def test_continuous_over_the_joints_limits(hand) -> None:
    env = hand()
    assert env.single_action_space.shape == (1,)
    assert env.action_manager.names == ("grip/gripper",)
    assert np.allclose(moved(env, -1.0), [0, 0])
    assert np.allclose(moved(env, 1.0), [0.04, 0.03])
    assert np.allclose(moved(env, 0.5), [0.03, 0.0225])
    assert np.allclose(moved(env, 9.0), [0.04, 0.03])
    # Half open by the mean of 0.25 and 1/3 of the way.
    assert np.allclose(env.action_manager.home(), 2 * (0.25 + 1 / 3) / 2 - 1)
    assert np.allclose(env.action_manager.hold(), np.ones((3, 1)))


def test_continuous_between_commands(hand) -> None:
    commands = {"lower_command": 0.01, "upper_command": {"finger_left": 0.03, ".*right": 0.02}}
    env = hand(**commands)
    assert np.allclose(moved(env, 0.0), [0.02, 0.015])
    assert np.allclose(env.action_manager.hold(), np.zeros((3, 1)), atol=1e-12)


def test_binary(hand) -> None:
    opened = {"finger_left": 0.04, "finger_right": 0.03}
    env = hand(command_mode="binary", open_command=opened, close_command=0.0)
    assert moved(env, -0.2) == [0, 0]
    assert env.action_manager.hold().tolist() == [[-1.0]] * 3
    assert np.allclose(moved(env, 0.0), [0.04, 0.03])
    assert env.action_manager.home().tolist() == [-1.0]  # a quarter open is nearer to closed


@pytest.mark.parametrize(
    ("params", "path", "part"),
    [
        ({"command_mode": "binary"}, "close_command", "missing"),
        ({"lower_command": 0.0}, "upper_command", "missing"),
        ({"open_command": 0.0}, "open_command", "no meaning in mode continuous"),
        (
            {"command_mode": "binary", "open_command": 1.0, "close_command": 1.0},
            "close_command",
            "both ends are the same",
        ),
        (
            {"use_joint_limits": True, "lower_command": 0.0},
            "lower_command",
            "contradicts use_joint_limits",
        ),
        (
            {"command_mode": "binary", "use_joint_limits": True},
            "use_joint_limits",
            "no meaning in mode binary",
        ),
        ({"joints": "wheel"}, "use_joint_limits", "need limits"),
        ({"command_mode": "both"}, "command_mode", "'continuous', 'binary'"),
        ({"lower_command": {"thumb": 1.0}, "upper_command": 1.0}, "lower_command.thumb", "thumb"),
    ],
)
def test_wrong_commands(hand, params, path, part) -> None:
    with pytest.raises(ConfigError, match=part) as caught:
        hand(**params)
    assert caught.value.problems[0].path == f"actions.grip.params.{path}"
