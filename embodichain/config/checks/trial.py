"""`try_zero_actions`: a few steps of a built environment, and what they show to be wrong or odd."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.config.checks.sunken import note_sunken
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["try_zero_actions"]

_STEPS = 10
"""Control steps in which divergence is looked for."""
_STEPS_WITH_CAMERAS = 3
"""Likewise, where each step draws pictures, of which a training has many."""
_STARTS = 16
"""Episodes whose first step is judged."""
_HELD = ("all", "min")
"""Reductions of a success that lasts for a whole episode, and may begin with it."""
_MOST_RESETS = 8
"""Resets that these take at most, of a task with few environments."""


@dataclass(slots=True)
class _Trial:
    """What the steps of a trial have shown.

    Attributes:
        diverged: (N,) environments that diverged in a step so far.
        successes: For each start, (N,) whether its first step was a success.
    """

    diverged: NDArray[np.bool_]
    successes: list[NDArray[np.bool_]] = field(default_factory=list)


def try_zero_actions(env: BaseEnv) -> list[Problem]:
    """Reset an environment, take some steps with zero actions, and judge what comes of it.

    Args:
        env: The environment, of this process, with its arrays on the host.

    Returns:
        A note on each robot and object that begins in the ground, and one if every episode begins
        as a success.

    Raises:
        ConfigError: All environments diverge: nothing can be learned or played.
    """
    from gymnasium.spaces import Box

    from embodichain.lab.gym.policies import zero
    from embodichain.lab.sim.sensors.camera import Camera

    if not isinstance(env.single_action_space, Box):
        return []  # a class with actions of its own: which of them does nothing is unknown
    has_cameras = any(isinstance(sensor, Camera) for sensor in env.sim.sensors.values())
    num_steps = _STEPS_WITH_CAMERAS if has_cameras else _STEPS
    trial = _Trial(np.zeros(env.num_envs, np.bool_))
    obs, _ = env.reset()
    notes = note_sunken(env)
    resets = 1
    for step in range(num_steps):
        obs, _, _, _, info = env.step(zero(obs, env))
        if step == 0:
            trial.successes.append(_flags(info, "success"))
        trial.diverged |= _flags(info, "diverged")
        if trial.diverged.all():
            raise ConfigError(_divergence(env, step + 1))
    if not _judges_arrival(env):
        return notes
    while trial.successes[-1].all() and resets < _MOST_RESETS and resets * env.num_envs < _STARTS:
        obs, _ = env.reset()
        _, _, _, _, info = env.step(zero(obs, env))
        trial.successes.append(_flags(info, "success"))
        resets += 1
    if not np.concatenate(trial.successes).all():
        return notes
    fact = f"true in the first step of all {resets * env.num_envs} episodes that were tried"
    advice = (
        "every policy succeeds at once, or the threshold is in another unit (m, rad); "
        "`reduce: all` is for a state that is to be held"
    )
    return [*notes, Problem(_success_path(env), f"{fact}: {advice}")]


def _flags(info: Any, name: str) -> NDArray[np.bool_]:
    return np.asarray(info[name], dtype=np.bool_).reshape(-1).copy()


def _judges_arrival(env: BaseEnv) -> bool:
    """Whether the task has a success that an episode does not begin with by its meaning."""
    metric = env.cfg.metrics.get("success")
    if metric is not None:
        return metric.reduce not in _HELD
    return any(term.kind == "success" for term in env.cfg.terminations.values())


def _success_path(env: BaseEnv) -> str:
    """The key of what judges success."""
    if env.cfg.metrics.get("success") is not None:
        return "task.metrics.success"
    for name, term in env.cfg.terminations.items():
        if term.kind == "success":
            return f"task.terminations.{name}"
    return "task.metrics"


def _divergence(env: BaseEnv, steps: int) -> list[Problem]:
    """The mistakes of a task in which every environment diverges."""
    where = f"in all {env.num_envs} environments" if env.num_envs > 1 else "in the environment"
    first = "first control step" if steps == 1 else f"first {steps} control steps"
    when = f"{where} in the {first}, with all actions at zero"
    problems: list[Problem] = []
    for term in env.not_finite_terms:
        # What is not a term is the sum of the rewards, of a class's hooks.
        path = f"task.{term}" if "." in term else "task.rewards"
        problems.append(Problem(path, f"not finite {when}: such a step ends its episode"))
    if problems:
        return problems
    fact = f"the physics diverges {when}"
    advice = (
        "use a shorter time step (usual are 0.001 to 0.01 s), smaller gains or larger masses, "
        "and look for bodies that begin inside of each other"
    )
    return [Problem("task.physics.physics_dt", f"{fact}: {advice}")]
