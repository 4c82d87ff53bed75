"""Promise 2: environment *i* makes the same bytes whatever num_envs and the threads are.

The first environments of each task are made anew, as a user makes them; the others share a scene
that was compiled for another number of them.
"""

import functools
import hashlib

import numpy as np
import pytest
import torch

import embodichain
from embodichain.config import list_options
from embodichain.config.environments.factory import make_env
from embodichain.config.resolved import compile_scene_of, resolve

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

STEPS = 24


def action_of(env, step):
    """Finite actions that depend on the environment's index and the step only."""
    space = env.single_action_space
    index = np.arange(env.num_envs)[:, None]
    wave = np.sin(0.7 * step + 1.3 * index + np.arange(space.shape[0]))
    low, high = np.maximum(space.low, -3.0), np.minimum(space.high, 3.0)
    return torch.from_numpy((low + (high - low) * (0.5 + 0.5 * wave)).astype(np.float32))


def tensors(tree):
    for value in tree.values():
        if isinstance(value, torch.Tensor):
            yield value
        elif hasattr(value, "values"):
            yield from tensors(value)


def make_anew(task, num_envs, threads, persistent):
    overrides = [
        *("seed=11", "task.max_episode_steps=9", f"sim.num_threads={threads}"),
        f"sim.persistent={str(persistent).lower()}",
    ]
    return embodichain.make(task, num_envs=num_envs, overrides=overrides)


@functools.lru_cache(maxsize=3)
def compiled(task):
    resolved = resolve([f"task={task}", "num_envs=1", "seed=11", "task.max_episode_steps=9"])
    return resolved, compile_scene_of(resolved)


def make_of_shared_scene(task, num_envs, threads, persistent):
    resolved, scene = compiled(task)
    sim = {**resolved.tree["sim"], "num_threads": threads, "persistent": persistent}
    return make_env(resolved.changed(num_envs=num_envs, sim=sim), compiled_scene=scene)


def history(task, num_envs, threads, persistent, make=make_of_shared_scene):
    """Digest of everything each environment produced, by environment."""
    env = make(task, num_envs, threads, persistent)
    digests = [hashlib.blake2b() for _ in range(num_envs)]

    def take(envs, *items):
        arrays = [t.contiguous().numpy() for t in items] + [env.sim.engine.rows]
        for i in envs:
            for array in arrays:
                digests[i].update(np.ascontiguousarray(array[i]).tobytes())

    obs, _ = env.reset()
    take(range(num_envs), *tensors(obs))
    resets = 0
    for step in range(STEPS):
        obs, reward, terminated, truncated, info = env.step(action_of(env, step))
        parts = (reward, terminated, truncated, info["elapsed_steps"], env.robot.get_qf())
        take(range(num_envs), *tensors(obs), *parts)
        if "final_obs" in info:
            resets += 1
            done = torch.nonzero(info["_final_obs"])[:, 0].tolist()
            take(done, *tensors(info["final_obs"]))
        if step == 4:  # a partial reset, of whole environments only
            obs, _ = env.reset(options={"reset_ids": list(range(0, num_envs, 2))})
            take(range(num_envs), *tensors(obs))
    assert resets, "automatic resets must be part of the history"
    env.close()
    return [d.hexdigest() for d in digests]


@pytest.fixture(scope="module")
def reference():
    tasks = ("random_reach", "push_cube", "reach")
    return {task: history(task, 64, 2, True, make_anew) for task in tasks}


@pytest.mark.parametrize("task", ["random_reach", "push_cube", "reach"])
@pytest.mark.parametrize(
    ("num_envs", "threads", "persistent"),
    [
        (1, 1, True),
        (1, 2, False),
        (3, 1, True),
        (3, 2, False),
        (3, 5, True),
        (64, 1, False),
        (64, 5, True),
        (64, 5, False),
    ],
)
def test_an_environment_makes_the_same_bytes(reference, task, num_envs, threads, persistent):
    assert history(task, num_envs, threads, persistent) == reference[task][:num_envs]


OTHERS = sorted({*list_options("task")} - {"random_reach", "push_cube", "reach", "hold_still"})


@pytest.mark.parametrize("task", OTHERS)
def test_every_other_task_too(task):
    reference = history(task, 6, 2, True, make_anew)
    assert len(set(reference)) == 6
    assert history(task, 1, 1, False) == reference[:1]
    assert history(task, 3, 2, False) == reference[:3]


def test_environments_differ_from_each_other(reference):
    for digests in reference.values():
        assert len(set(digests)) == 64
