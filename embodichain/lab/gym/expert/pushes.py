"""`Pushes`: disturbances of an expert's motions, which it then corrects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.mdp.actions.joint_action import JointAction
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.expert.arms import ControlledArm
    from embodichain.lab.sim.engine.api import F64

__all__ = ["Pushes"]

_PUSH_PROBABILITY = 0.06
"""Of each control step without a push, that one begins."""
_PUSH_STEPS = 4
_STREAM = "expert/pushes"


class Pushes:
    """Normally distributed motions that are added to the actions of arms, for four steps each.

    Tools are pushed in their position, arms with joint actions in all joints.

    Args:
        env: The environment; pushes of environment *i* do not depend on N.
        arms: The arms.
        size: Standard deviation as a share of half the actions' range.

    Raises:
        ConfigError: If the actions of an arm have no bounds.
    """

    def __init__(self, env: BaseEnv, arms: Sequence[ControlledArm], size: float) -> None:
        space: Any = env.single_action_space
        self._env = env
        self._low: F64 = space.low.astype(np.float64)
        self._high: F64 = space.high.astype(np.float64)
        self._std: F64 = np.zeros(len(self._low))
        for arm in arms:
            columns = np.arange(len(self._low))[arm.columns]
            if not isinstance(arm.term, JointAction):
                columns = columns[:3]
            self._std[columns] = 0.5 * size * (self._high - self._low)[columns]
        if not np.isfinite(self._std).all():
            message = "is a share of the actions' range, and an action has no bounds"
            raise ConfigError([Problem("policy.params.pushes", message)])
        self._remaining_steps: NDArray[np.int64] = np.zeros(env.num_envs, np.int64)
        self._push: F64 = np.zeros((env.num_envs, len(self._low)))

    def add_pushes(self, action: F64, done: NDArray[np.bool_]) -> F64:
        """Draw the pushes of this control step; return the actions with them, within bounds.

        Args:
            action: (N, A).
            done: (N,) environments in which nothing is left to do: they are not pushed.
        """
        # Both are drawn in each step, so that the numbers do not depend on when pushes began.
        may_begin = self._env.rand(_STREAM).numpy() < _PUSH_PROBABILITY
        drawn = self._env.randn(f"{_STREAM}/size", (len(self._low),)).numpy().astype(np.float64)
        begins = may_begin & (self._remaining_steps == 0)
        self._remaining_steps[begins] = _PUSH_STEPS
        self._push = np.where(begins[:, None], drawn * self._std, self._push)
        is_pushed = (self._remaining_steps > 0) & ~done
        self._remaining_steps -= self._remaining_steps > 0
        pushed_action = np.clip(action + self._push, self._low, self._high)
        return np.where(is_pushed[:, None], pushed_action, action)
