"""Drives of every shipped task: nothing diverges under random actions, and robots rest at rest.

Both tests of a task share its scene, compiled once.
"""

import numpy as np
import pytest

from embodichain.config import list_options
from embodichain.config.environments.factory import make_env
from embodichain.config.resolved import compile_scene_of, resolve
from embodichain.lab.gym.policies import random

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

TASKS = list_options("task")
ENVIRONMENTS, STEPS = 50, 10_000
CAMERAS = {"lift_vision": ("room", "wrist"), "reach_vision": ("front", "side")}
"""They move nothing, and drawing their pictures takes most of the time."""


@pytest.fixture(scope="module", params=TASKS)
def make(request):
    """Makes the environment of a task."""
    cameras = CAMERAS.get(request.param, ())
    without = [f"~task.{of}.{name}" for name in cameras for of in ("sensors", "observations")]
    resolved = resolve([f"task={request.param}", "seed=0", *without])
    scene = compile_scene_of(resolved)

    def make(num_envs):
        return make_env(resolved.changed(num_envs=num_envs), compiled_scene=scene)

    return make


def test_ten_thousand_steps_of_random_actions_do_not_diverge(make):
    env = make(ENVIRONMENTS)
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


def test_a_robot_that_is_told_nothing_comes_to_rest(make):
    env = make(1)
    drives = env.robot.drives
    if not (drives.stiffness > 0).any():
        assert list(env.sim.robots) == ["cart_pole"]  # pushed by efforts: nothing holds it
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
