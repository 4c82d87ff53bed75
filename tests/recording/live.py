"""Runs of tasks whose log is recorded, and whose observations are stored as they are made."""

import numpy as np
import torch

from embodichain.config.environments.factory import make_env
from embodichain.config.resolved import dump_yaml, resolve
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.recording import McapRecorder
from embodichain.utils.tensor_mapping import leaves_of

NOISY = [
    "task=reach",
    "task.max_episode_steps=9",
    "+task.observations.past={func: joint_position, history_length: 3, delay: [1, 2], "
    "noise: {type: gaussian, std: 0.1}, params: {of: {uid: robot}}}",
    "+task.observations.latest={func: last_action, group: critic}",
]
"""Overrides of a task whose observations have noise, a delay, a history and two groups."""


class Live(StepObserver):
    """Stores what the policy sees: per environment and episode, first and final ones included."""

    def __init__(self, env, first):
        self.seen = {(i, 0): [self.row(first, i)] for i in range(env.num_envs)}

    @staticmethod
    def row(obs, i):
        return {"/".join(path): np.array(leaf[i].numpy()) for path, leaf in leaves_of(obs)}

    def on_step(self, env, step):
        for i, episode in enumerate(step.episode_ids.tolist()):
            done = step.terminated[i] or step.truncated[i]
            self.seen[i, episode].append(self.row(step.info["final_obs"] if done else step.obs, i))
            if done:
                self.seen[i, episode + 1] = [self.row(step.obs, i)]


def record_task(path, overrides, steps, options=None, cut=(), touch=None, said=None):
    """Records a run of a task with random actions.

    Args:
        path: The log.
        overrides: Of a run's config.
        steps: Control steps.
        options: `RecordOptions`.
        cut: Control steps in which an episode is truncated.
        touch: Called with the environment and the number of each step.
        said: The config that is put into the log instead of the run's.

    Returns:
        The log, and what was observed: (environment, episode) to a list of observations.
    """
    resolved = resolve(["num_envs=3", "seed=3", *overrides])
    env = make_env(resolved)
    text = dump_yaml(resolved.tree) if said is None else said
    env.add_observer(McapRecorder(path, env, text, [], options, resolved.task_name))
    obs, _ = env.reset()
    live = Live(env, obs)
    env.add_observer(live)
    draw = torch.Generator().manual_seed(1)
    for step in range(steps):
        if step in cut:
            env.truncate(np.array([step % 3]))
        if touch is not None:
            touch(env, step)
        env.step(2 * torch.rand((3, *env.single_action_space.shape), generator=draw) - 1)
    env.close()
    return path, live.seen
