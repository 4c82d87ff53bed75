"""What is measured: this environment in several dress, and the bare batch it is compared with.

An arm is built before the first clock starts and then does control steps when told. Peers are in
`peers.py`; how arms take turns is in `rounds.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv

CYCLE = 16
"""Actions drawn before the clock starts; what they cost is no environment's."""
SEED = 0
LINK_POSE = (
    "+task.observations.tool={func: link_pose, "
    "params: {entity_cfg: {uid: ur10, link_names: [ee_link]}}}"
)


@dataclass(frozen=True)
class Arm:
    """Something that makes control steps.

    Attributes:
        name: What it is.
        num_envs: Environments that one call steps.
        floor: Name of the arm it is compared with, of the same size.
        step: One control step, given its number.
        prepare: Runs before the clock starts.
        finish: Runs before the clock stops: work that a step left for later.
        close: Frees it.
        timers: Whether MuJoCo's own timers run: as its Python package comes, they do.
    """

    name: str
    num_envs: int
    floor: str
    step: Callable[[int], object]
    prepare: Callable[[], object] = lambda: None
    finish: Callable[[], object] = lambda: None
    close: Callable[[], object] = lambda: None
    timers: bool = True


def actions_for(env: BaseEnv) -> list[NDArray[np.float32]]:
    """`CYCLE` actions (N, A): uniform within 0.1 of the middle of what the policy may ask.

    For absolute joint targets the middle is the initial configuration, as in the tutorial; for a
    bounded Box about zero (push_cube) actions fill the Box.
    """
    generator = np.random.default_rng(SEED)
    low, high = env.single_action_space.low, env.single_action_space.high
    shape = (CYCLE, env.num_envs, len(low))
    if np.allclose(low, -high) and np.abs(high).max() <= 1:
        middle, half = np.zeros_like(high), high
    else:
        middle, half = env.robot.get_qpos().cpu().numpy()[0], 0.1
    drawn = middle + half * generator.uniform(-1, 1, shape)
    return list(np.clip(drawn, low, high).astype(np.float32))


def environment(
    env: BaseEnv, name: str, floor: str, finish: Callable[[], object] = lambda: None
) -> Arm:
    """An environment of ours, under actions drawn beforehand."""
    import torch

    env.reset(seed=SEED)
    actions = [torch.from_numpy(action).to(env.device) for action in actions_for(env)]
    return Arm(
        name,
        env.num_envs,
        floor,
        lambda step: env.step(actions[step % CYCLE]),
        finish=finish,
        close=env.close,
        timers=False,
    )


def recorded(env: BaseEnv, name: str, floor: str, folder: Path) -> Arm:
    """The same with a log; its clock stops when everything is in the file.

    Waiting for the writer's backlog makes the figure one that can be kept up for hours.
    """
    from embodichain.recording import McapRecorder

    recorder = McapRecorder(folder / f"{name}-{env.num_envs}.mcap", env)
    env.add_observer(recorder)
    return environment(env, name, floor, recorder.flush)


def bare(
    name: str, env: BaseEnv, nthread: int, floor: str | None = None, timers: bool = True
) -> Arm:
    """`mujoco.batch.Batch.step` of an environment's model, with nothing bound.

    One MjData per environment (persistent). Every round starts from states that the environment
    visited, so that contacts are those of the task.

    Args:
        name: The arm's name.
        env: Whose model, states and number of physics steps to take.
        nthread: Threads; never more than environments.
        floor: What it is compared with; None is itself.
        timers: Whether MuJoCo's own timers run.
    """
    from mujoco import batch as mjbatch

    engine, nstep = env.sim.engine, env.sim_steps_per_control
    batch = mjbatch.Batch(
        engine.model, env.num_envs, nthread=min(nthread, env.num_envs), persistent=True
    )
    batch.reset()

    def prepare() -> None:
        batch.state[:] = engine.rows

    return Arm(
        name,
        env.num_envs,
        floor or name,
        lambda step: batch.step(nstep=nstep),
        prepare,
        timers=timers,
    )


def make(task: str, num_envs: int, *overrides: str, **kwargs: Any) -> BaseEnv:
    """An environment of a YAML task, built as `embodichain run` builds it."""
    import embodichain

    return embodichain.make(task, num_envs, overrides, **kwargs)
