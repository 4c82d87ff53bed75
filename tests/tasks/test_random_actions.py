"""Drives of every shipped task: nothing diverges under random actions, and robots rest at rest."""

import numpy as np
import pytest

import embodichain
from embodichain.config import list_options
from embodichain.lab.gym.policies import random

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

TASKS = list_options("task")
ENVIRONMENTS, STEPS = 50, 10_000
CAMERAS = {"lift_vision": ("room", "wrist"), "reach_vision": ("front", "side")}
"""They move nothing, and drawing their pictures takes most of the time."""


@pytest.mark.parametrize("task", TASKS)
def test_ten_thousand_steps_of_random_actions_do_not_diverge(task):
    without = [
        f"~task.{of}.{c}" for c in CAMERAS.get(task, ()) for of in ("sensors", "observations")
    ]
    env = embodichain.make(task, num_envs=ENVIRONMENTS, overrides=["seed=0", *without])
    obs, _ = env.reset()
    reached = np.zeros_like(env.single_action_space.low), np.zeros_like(env.single_action_space.low)
    for _ in range(STEPS // ENVIRONMENTS):
        action = random(obs, env)
        np.minimum(reached[0], action.numpy().min(axis=0), out=reached[0])
        np.maximum(reached[1], action.numpy().max(axis=0), out=reached[1])
        obs, *_, info = env.step(action)
        assert not info["diverged"].any()
    low, high = env.single_action_space.low, env.single_action_space.high
    assert (reached[0] < 0.95 * low).all() and (reached[1] > 0.95 * high).all()  # the whole space
    env.close()


@pytest.mark.parametrize("task", TASKS)
def test_a_robot_that_is_told_nothing_comes_to_rest(task):
    env = embodichain.make(task, num_envs=1, overrides=["seed=0"])
    drives = env.robot.drives
    if not (drives.stiffness > 0).any():
        assert task.startswith("cart_pole")  # pushed by efforts: nothing holds it
        env.close()
        return
    env.reset()
    env.robot.set_qpos(env.robot.get_qpos())
    env.sim.update(step=round(4.0 / env.physics_dt))
    speeds = []
    for _ in range(20):
        env.sim.update(step=1)
        speeds.append(env.robot.read_qvel()[0].copy())
    assert np.abs(np.diff(speeds, axis=0)).max() < 1e-3  # no chatter
    # A legged robot's feet still creep on MuJoCo's soft contacts, ever slower.
    assert np.abs(speeds).max() < (1e-3 if env.robot.parsed.fixed_base else 0.1)
    env.close()
