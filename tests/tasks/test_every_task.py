"""What every task that ships must do: stated once, run over all of them.

The tests of one task share its scene, compiled once, and follow each other; `gymnasium.make` and
`make_vec`, and what changes the scene, compile their own.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
import yaml
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3
from stable_baselines3.common.preprocessing import is_image_space

import embodichain
from embodichain.config import list_options
from embodichain.config.checks.trial import try_zero_actions
from embodichain.config.environments.factory import make_env
from embodichain.config.resolved import Resolved, compile_scene_of, resolve
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.sim.compiler.compile_scene import CompiledScene
from embodichain.learning import SB3VecEnv
from embodichain.recording import McapRecorder, verify
from tests.end_to_end.test_invariance import action_of, tensors

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

CONF = Path(embodichain.__file__).parent / "conf" / "task"
TASKS = list_options("task")


def declared(task):
    return yaml.safe_load((CONF / f"{task}.yaml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Task:
    """A task that ships, and its scene."""

    name: str
    resolved: Resolved
    scene: CompiledScene

    def make(self, num_envs: int, seed: int, **values: object) -> BaseEnv:
        """Its environment; `values` are keys of the task."""
        resolved = self.resolved.changed(num_envs=num_envs, seed=seed)
        if values:
            resolved = resolved.changed(task={**resolved.tree["task"], **values})
        return make_env(resolved, compiled_scene=self.scene)


@pytest.fixture(scope="module", params=TASKS)
def task(request):
    resolved = resolve([f"task={request.param}", "policy=random"], "run")
    return Task(request.param, resolved, compile_scene_of(resolved))


WITH_SUCCESS = pytest.mark.parametrize(
    "task", [name for name in TASKS if name != "random_reach"], indirect=True, scope="module"
)


def has_images(env):
    manager = env.observation_manager
    return "policy" in manager.groups and bool(manager.image_terms("policy"))


def test_the_tasks_are_those_of_the_folder():
    assert sorted(TASKS) == sorted(path.stem for path in CONF.glob("*.yaml"))
    expected = {
        "random_reach",
        "reach",
        "reach_workspace",
        "reach_pose",
        "cart_pole",
        "cart_pole_swing_up",
        "push_cube",
        "lift_cube",
        "quadruped_velocity",
        "quadruped_rough",
        "humanoid_velocity",
        "hold_still",
        "reach_vision",
        "lift_vision",
        "pick_place",
        "stack_cubes",
        "peg_in_hole",
        "hand_over",
        "press_button",
        "open_drawer",
    }
    assert expected <= set(TASKS)


def test_task_file_says_what_it_is(task):
    text = (CONF / f"{task.name}.yaml").read_text(encoding="utf-8")
    assert len(declared(task.name)["description"]) > 20
    assert text.startswith("#")


def test_nothing_in_a_task_looks_wrong(task):
    notes = [str(note) for note in task.resolved.notes]
    # An armature that was raised is told of, but right: a new task need not have it.
    assert [note for note in notes if "drive_pros.armature: raised to" not in note] == []
    env = task.make(2, 1)
    assert try_zero_actions(env) == []
    env.close()


@WITH_SUCCESS
def test_task_has_a_reward_and_a_success(task):
    tree = task.resolved.tree["task"]
    assert tree["rewards"]
    assert "success" in tree["metrics"]


def test_gymnasium_environment_of_a_task_passes_both_checkers(task):
    env = gym.make(f"embodichain/{task.name}-v0")
    space = env.observation_space
    if task.name.endswith("_vision"):
        images = [part for part in space.values() if len(part.shape) == 3]
        assert len(images) == 2 and all(is_image_space(image) for image in images)
    else:
        assert isinstance(space, gym.spaces.Box)
        assert space.dtype == np.float32 and len(space.shape) == 1
    with warnings.catch_warnings():
        # What they recommend (bounded observations, actions in [-1, 1]) is the task's choice.
        warnings.filterwarnings("error", category=UserWarning)
        warnings.filterwarnings("ignore", ".*(infinity|symmetric and normalized).*")
        check_env(env.unwrapped, skip_render_check=True)
        check_env_sb3(env, skip_render_check=True)
    env.close()


def test_gymnasium_batch_of_a_task_is_numpy(task):
    env = gym.make_vec(f"embodichain/{task.name}-v0", num_envs=2)
    obs, _ = env.reset(seed=0)
    assert env.observation_space.contains(obs)
    obs, reward, *_ = env.step(env.action_space.sample())
    assert env.observation_space.contains(obs) and np.isfinite(reward).all()
    env.close()


def test_observations_are_finite_and_in_their_space(task):
    env = task.make(num_envs=3, seed=4)
    space = env.single_observation_space
    obs, _ = env.reset()
    for step in range(30):
        obs, reward, *_ = env.step(action_of(env, step))
        assert torch.isfinite(reward).all()
        assert all(torch.isfinite(leaf).all() for leaf in tensors(obs))
    flat = [leaf.shape[1:] for leaf in tensors(obs)]
    assert sum(int(np.prod(shape)) for shape in flat) == gym.spaces.utils.flatdim(space)
    env.close()


def test_task_log_verifies(task, tmp_path):
    env = task.make(num_envs=2, seed=1, max_episode_steps=7)
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env))
    env.reset()
    for step in range(10):
        env.step(action_of(env, step))
    env.close()
    report = verify(tmp_path / "log.mcap")
    assert report.ok, report


@WITH_SUCCESS
def test_sb3_vector_environment_plays_a_task(task):
    batch = task.make(num_envs=2, seed=3, max_episode_steps=5)
    env = SB3VecEnv(batch, flatten=not has_images(batch))
    obs = env.reset()
    ended = 0
    for _ in range(6):
        action = np.stack([env.action_space.sample() for _ in range(2)])
        obs, _, dones, infos = env.step(action)
        ended += sum("episode" in info for info in infos)
        assert dones.sum() == sum("terminal_observation" in info for info in infos)
    assert ended >= 2
    assert obs is not None
    env.close()


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(task):
    def played(seed):
        env = task.make(num_envs=2, seed=seed)
        obs, _ = env.reset()
        for step in range(5):
            obs, *_ = env.step(action_of(env, step))
        found = [leaf.numpy().tobytes() for leaf in tensors(obs)]
        env.close()
        return found

    first = played(1)
    assert first == played(1)
    if task.resolved.tree["task"].get("events"):
        assert first != played(2)


def test_task_config_composes_to_one_tree(task):
    tree = task.resolved.tree["task"]
    assert tree["description"] == declared(task.name)["description"]


def lowest(model, data, geoms):
    """Height of the lowest point of some shapes, m: a mesh's vertex, else a corner of a box."""
    heights = []
    for geom in geoms:
        upwards = data.geom_xmat[geom].reshape(3, 3)[2]
        mesh = model.geom_dataid[geom]
        if mesh >= 0:
            start = model.mesh_vertadr[mesh]
            low = (model.mesh_vert[start : start + model.mesh_vertnum[mesh]] @ upwards).min()
        else:
            low = upwards @ model.geom_aabb[geom, :3] - abs(upwards) @ model.geom_aabb[geom, 3:]
        heights.append(data.geom_xpos[geom, 2] + low)
    return min(heights)


def test_task_robots_do_not_float(task):
    env = task.make(num_envs=1, seed=1)
    env.reset()
    scene = env.sim.scene
    data = env.sim.engine.data_of(0)
    tops = [0.0]  # the ground
    for uid, thing in env.sim.rigid_objects.items():
        geoms = scene.entities[uid].geom_ids
        if thing.cfg.body_type == "static" and uid != "table":
            assert not scene.model.geom_contype[geoms].any(), f"{uid} is in the robot's way"
            tops.append(2 * float(data.geom_xpos[geoms, 2].max()))
    for uid in env.sim.robots:
        geoms = scene.entities[uid].geom_ids
        fixed = scene.model.body_treeid[scene.model.geom_bodyid[geoms]] < 0
        base = lowest(scene.model, data, geoms[fixed] if fixed.any() else geoms)
        assert min(abs(base - top) for top in tops) < 0.05, f"{uid} floats at {base}"
    env.close()


STANDS = [t for t in TASKS if "pedestal" in declared(t).get("scene", {})]


@pytest.mark.parametrize("task", STANDS, indirect=True, scope="module")
def test_task_pedestal_changes_nothing(task):
    def steps(env):
        seen = [env.reset()[0]]
        seen += [env.step(action_of(env, step))[0] for step in range(20)]
        env.close()
        return [leaf for obs in seen for leaf in tensors(obs)]

    with_it = steps(task.make(num_envs=2, seed=2))
    overrides = ["seed=2", "~task.scene.pedestal"]
    without = steps(embodichain.make(task.name, num_envs=2, overrides=overrides))
    assert all(torch.equal(a, b) for a, b in zip(with_it, without, strict=True))
