"""`check_shapes`: terms that judge a step, called once when an environment is built.

A term of the wrong shape is so refused before anyone waits for the first step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import torch

from embodichain.lab.gym.envs.context import TermContext

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.metric_manager import MetricManager
    from embodichain.lab.gym.envs.managers.reward_manager import RewardManager
    from embodichain.lab.gym.envs.managers.termination_manager import TerminationManager
    from embodichain.lab.sim.types import EnvObs

__all__ = ["JudgedEnv", "check_shapes"]


class JudgedEnv(TermContext, Protocol):
    """An environment whose managers of steps are built."""

    @property
    def termination_manager(self) -> TerminationManager:
        """The terminations."""
        ...

    @property
    def metric_manager(self) -> MetricManager:
        """The metrics."""
        ...

    @property
    def reward_manager(self) -> RewardManager:
        """The rewards."""
        ...


def check_shapes(env: JudgedEnv, obs: EnvObs) -> None:
    """Call every termination, metric and reward once, and take back what that changed.

    Random streams are put back and terms are reset, so that nothing of it shows later. For
    environments whose `evaluate` is the default: another one may put entries into ``info`` that
    terms rely on, and may need a reset first; there the first step checks.

    Args:
        env: The environment, complete.
        obs: An observation of it.

    Raises:
        ValueError: If a term's value has another shape than (N,); names the term.
    """
    managers = env.termination_manager, env.metric_manager, env.reward_manager
    if not any(len(manager) for manager in managers):
        return
    count = env.num_envs
    nobody = torch.zeros(count, dtype=torch.bool)
    info: dict[str, Any] = {
        "elapsed_steps": env.elapsed_steps,
        "success": nobody,
        "fail": nobody.clone(),
    }
    action = env.last_action
    saved = env.streams.state_dict()
    env.termination_manager.compute(obs, action, info)
    env.metric_manager.compute(obs, action, info)
    env.reward_manager.compute(None, obs, action, info)
    env.streams.load_state_dict(saved)
    for manager in managers:
        manager.reset(None)
