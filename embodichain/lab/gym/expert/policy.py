"""`Expert`: the policy that performs the steps in a task's section `expert`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import NonNegative
from embodichain.lab.gym.expert.execution import Execution
from embodichain.lab.gym.expert.program import steps_of
from embodichain.utils.arrays import tensor_of

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.types import EnvObs

__all__ = ["Expert"]


class Expert:
    """Performs the steps in the task's section `expert`.

    It plans from the measured poses of tool and targets, when a motion begins, and acts through the
    task's own actions. An environment where a step fails keeps the tool where it is. The actions of
    an environment do not depend on the number of environments.

    Args:
        steps: Steps in place of the task's: a list as in a task file, or a function ``f(env)`` that
            returns one (Python only).
        pushes: Standard deviation of pushes, as a share of half the actions' range: in 6 % of the
            steps begins one that adds a drawn motion of the tool to the action for four steps. The
            expert corrects what they do, so that demonstrations show how to come back (Laskey et
            al., "DART: Noise injection for robust imitation learning", 2017, arXiv:1703.09327).
    """

    def __init__(self, steps: Any = None, pushes: NonNegative = 0.0) -> None:
        self._steps = steps
        self._pushes = pushes
        self._execution: Execution | None = None

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        """Return (N, A) float32 actions.

        Raises:
            ConfigError: At the first call, if the steps are wrong or cannot be done in this task.
        """
        if self._execution is None or self._execution.env is not env:
            expert = env.cfg.expert if self._steps is None else self._steps
            self._execution = Execution(env, steps_of(expert, env), self._pushes)
        return tensor_of(self._execution.act().astype(np.float32))

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin anew in these environments; (n,) int64, or None for all."""
        if self._execution is not None:
            self._execution.reset(env_ids)

    @property
    def done(self) -> NDArray[np.bool_]:
        """(N,) whether all steps are done or one failed; empty before the first action."""
        if self._execution is None:
            return np.zeros(0, np.bool_)
        return self._execution.done

    @property
    def failures(self) -> Sequence[str | None]:
        """The step that failed in each environment, and why; empty before the first action."""
        if self._execution is None:
            return ()
        return self._execution.failures
