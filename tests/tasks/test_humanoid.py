"""The humanoid stands on its feet: weights and a controller worked out by hand."""

import numpy as np
import pytest
import torch

import embodichain

pytestmark = pytest.mark.slow

STEADY = ["seed=1", "sim.num_threads=1", "~task.events.push", "~task.events.base"]
ANKLES = [4, 10]
"""Pitch of the left and the right ankle among the actions, which turn targets by 0.25 rad each."""


@pytest.fixture(scope="module")
def env():
    found = embodichain.make("humanoid_velocity", num_envs=2, overrides=STEADY)
    yield found.unwrapped
    found.close()


def balance(env, steps, stiffness, damping):
    """Steps until the first fall, with ankles that push back against the root's way along x."""
    engine = env.sim.engine
    env.reset(seed=1)
    home = engine.rows[:, engine.component("qpos")][:, 0].copy()
    for step in range(steps):
        way = engine.rows[:, engine.component("qpos")][:, 0] - home
        speed = engine.rows[:, engine.component("qvel")][:, 0]
        action = np.zeros((2, 12), np.float32)
        action[:, ANKLES] = np.clip((stiffness * way + damping * speed) / 0.25, -4, 4)[:, None]
        _, _, terminated, _, _ = env.step(torch.from_numpy(action))
        if terminated.any():
            return step
    return steps


def test_it_stands_by_its_ankles_and_falls_without_them(env):
    # 33 kg at 0.69 m tip with 33 x 9.81 = 327 N m per metre of way. The springs of two ankles,
    # 80 N m/rad, turned by the lean of 1 / 0.69 rad/m, hold 116; with another 8 rad/m, 756.
    assert balance(env, 200, 0.0, 0.0) < 100
    assert balance(env, 250, 8.0, 2.0) == 250
    model, engine = env.sim.scene.model, env.sim.engine
    weight = model.body_mass.sum() * 9.81
    assert weight == pytest.approx(33.34 * 9.81, rel=1e-3)
    upwards = env.sim.get_sensor("feet").read_force()[..., 2]
    np.testing.assert_allclose(upwards.sum(axis=1), weight, rtol=1e-3)
    np.testing.assert_allclose(upwards[:, 0], upwards[:, 1], rtol=0.3)  # noise of the first angles
    assert engine.data_of(0).ncon == 8  # four spheres a foot, and nothing else


def test_only_the_legs_have_joints_in_left_and_right_pairs(env):
    robot = env.sim.get_robot("robot")
    legs = [f"{part}_joint" for part in ("hip_pitch", "hip_roll", "hip_yaw", "knee")]
    legs += ["ankle_pitch_joint", "ankle_roll_joint"]
    assert list(robot.joint_names) == [
        f"{side}_{leg}" for side in ("left", "right") for leg in legs
    ]
    assert env.single_action_space.shape == (12,)
