"""`write_joint_state`: positions and velocities at once, for some environments, in the log."""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch

from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.recording import McapRecorder, verify
from tests.lab.gym.conftest import HOME, home


def robot_of(env: Any) -> Any:
    env.reset()
    return env.sim.get_robot("ur10")


def test_it_is_there_at_once_and_targets_follow(make_env: Any) -> None:
    robot = robot_of(make_env())
    before = robot.get_qpos()
    qpos = torch.tensor(HOME) + 0.1 * torch.arange(6)
    qvel = 0.5 * torch.arange(6)
    robot.write_joint_state(qpos, qvel, env_ids=[0, 2])
    for found, wanted in ((robot.get_qpos(), qpos), (robot.get_qpos(target=True), qpos)):
        assert found[[0, 2]].numpy() == pytest.approx(wanted.repeat(2, 1).numpy(), abs=1e-6)
        assert torch.equal(found[1], before[1])
    assert robot.get_qvel()[0].numpy() == pytest.approx(qvel.numpy())
    assert not robot.get_qvel()[1].any()
    # What is computed from positions is that of MuJoCo's own forward kinematics.
    engine = robot.engine
    data = mujoco.MjData(engine.model)
    data.qpos[:] = engine.state("qpos")[0]
    mujoco.mj_kinematics(engine.model, data)
    tip = robot.link_names[-1]
    there = data.body(robot.body_of(tip)).xpos
    assert robot.get_link_pose(tip)[0, :3].numpy() == pytest.approx(there, abs=1e-6)


def test_set_qpos_still_moves_targets_alone(make_env: Any) -> None:
    robot = robot_of(make_env())
    before = robot.get_qpos()
    robot.set_qpos(before + 0.2)
    assert torch.equal(robot.get_qpos(), before)
    assert robot.get_qpos(target=True).numpy() == pytest.approx((before + 0.2).numpy(), abs=1e-6)


def test_some_joints_at_rest_and_beyond_their_limits(make_env: Any) -> None:
    robot = robot_of(
        make_env(
            robot=RobotCfg(
                uid="ur10",
                fpath="UniversalRobots/UR10/UR10.urdf",
                init_pos=(0.0, 0.0, 1.0),
                init_qpos=HOME,
            )
        )
    )
    before = robot.get_qpos()
    robot.set_qvel(torch.ones(6), target=False)
    upper = robot.get_qpos_limits()[:, [4, 1], 1]
    robot.write_joint_state(upper + 0.25, joint_ids=[4, 1])
    assert torch.equal(robot.get_qpos()[:, [0, 2, 3, 5]], before[:, [0, 2, 3, 5]])
    assert robot.get_qpos()[:, [4, 1]].numpy() == pytest.approx((upper + 0.25).numpy())
    assert robot.get_qpos(target=True)[:, [4, 1]].numpy() == pytest.approx(upper.numpy())
    assert robot.get_qvel()[0].tolist() == [1, 0, 1, 1, 0, 1]


@pytest.mark.parametrize(
    ("qpos", "more", "words"),
    [
        (np.zeros(5), {}, "qpos"),
        (np.full(6, np.nan), {}, "qpos"),
        (np.zeros(6), {"qvel": np.zeros(3)}, "qvel"),
        (np.zeros(1), {"joint_ids": [6]}, "joint_ids"),
    ],
)
def test_mistakes_write_nothing(make_env: Any, qpos: Any, more: Any, words: str) -> None:
    robot = robot_of(make_env())
    before = robot.engine.rows.tobytes()
    with pytest.raises(ValueError, match=words):
        robot.write_joint_state(qpos, **more)
    assert robot.engine.rows.tobytes() == before


def test_a_joint_without_a_drive_has_no_target_to_follow(make_env: Any) -> None:
    free = RobotCfg(
        uid="ur10",
        fpath="UniversalRobots/UR10/UR10.urdf",
        init_pos=(0.0, 0.0, 1.0),
        drive_pros=JointDrivePropertiesCfg(drive_type="none"),
    )
    robot = robot_of(make_env(robot=free))
    robot.write_joint_state(np.full(6, 0.3), np.full(6, -1.0))
    assert robot.get_qpos().numpy() == pytest.approx(0.3)
    assert robot.get_qvel().numpy() == pytest.approx(-1.0)


def test_it_is_in_the_log(make_env: Any, tmp_path: Any) -> None:
    env = make_env()
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env))
    robot = robot_of(env)
    for step in range(8):
        if step == 4:
            robot.write_joint_state(np.array(HOME) + 0.2, np.full(6, 0.4), env_ids=[1])
        env.step(home(env))
    env.close()
    report = verify(tmp_path / "log.mcap")
    assert report.ok and report.steps == 8
