"""`ActionManager` and the base of its terms: an action is cut into slices, one a term.

The terms themselves are in `envs/mdp/actions.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.gym.envs.managers.base import Manager, Term
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["ActionManager", "ActionTerm"]


class ActionTerm(Term):
    """Base of action terms; subclasses take ``(env, **params)``.

    Attributes:
        low: (A,) float32 lower bounds of its slice, finite.
        high: (A,) float32 upper bounds, finite.
        names: What each column moves, for tables and logs.
    """

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    names: tuple[str, ...] = ()

    @property
    def action_dim(self) -> int:
        """Width A of its slice."""
        return len(self.low)

    def apply(self, action: torch.Tensor) -> None:
        """Act on the scene; called once a control step, before physics.

        Args:
            action: (N, A) float32, finite.
        """
        raise NotImplementedError

    def home(self) -> NDArray[np.float64]:
        """(A,) the action that goes to the initial state; policies explore around it."""
        return np.clip(np.zeros(len(self.low)), self.low, self.high)

    def hold(self) -> NDArray[np.float64]:
        """(N, A) or (A,) the action that changes nothing now."""
        return self.home()


class ActionManager(Manager[ActionTermCfg]):
    """Terms that own consecutive slices of the action, in declared order.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> action term.

    Attributes:
        action_dim: Width of the whole action.
        low: (A,) float32 lower bounds of the action.
        high: (A,) float32 upper bounds.
        slices: Name -> columns.

    Raises:
        ConfigError: If a term is wrong, or its bounds are not finite and ordered.
    """

    def __init__(self, env: BaseEnv, cfgs: Mapping[str, ActionTermCfg]) -> None:
        super().__init__(env, "actions", "action", cfgs)
        self.slices: dict[str, slice] = {}
        start = 0
        lows: list[NDArray[np.float32]] = [np.zeros(0, np.float32)]
        highs: list[NDArray[np.float32]] = [np.zeros(0, np.float32)]
        for name, term in self.terms.items():
            if not hasattr(term.instance, "low") or not hasattr(term.instance, "high"):
                message = f"{term.spec.label} must set low and high"
                raise ConfigError([Problem(f"actions.{name}.func", message)])
            low, high = (np.asarray(b, np.float32) for b in (term.instance.low, term.instance.high))
            width = int(term.instance.action_dim)
            if low.shape != (width,) or high.shape != (width,) or not _bounded(low, high):
                message = f"needs finite bounds low < high of shape ({width},), got {low}, {high}"
                raise ConfigError([Problem(f"actions.{name}", message)])
            self.slices[name] = slice(start, start + width)
            start += width
            lows.append(low)
            highs.append(high)
        self.action_dim = start
        self.low: NDArray[np.float32] = np.concatenate(lows)
        self.high: NDArray[np.float32] = np.concatenate(highs)
        self._calls = [(term.call, self.slices[name]) for name, term in self.terms.items()]

    @property
    def names(self) -> tuple[str, ...]:
        """What each column of the action moves: ``TERM/JOINT``."""
        found: list[str] = []
        for name, term in self.terms.items():
            width = self.slices[name].stop - self.slices[name].start
            columns = term.instance.names or tuple(map(str, range(width)))
            found += [f"{name}/{column}" for column in columns]
        return tuple(found)

    def apply(self, action: torch.Tensor) -> None:
        """Hand every term its slice of the action.

        Args:
            action: (N, A) float32, finite: the environment has checked it.
        """
        if len(self._calls) == 1:
            self._calls[0][0](action)
            return
        for call, columns in self._calls:
            call(action[:, columns])

    def home(self) -> NDArray[np.float64]:
        """(A,) the action that goes to the initial state."""
        return np.concatenate([np.zeros(0), *(t.instance.home() for t in self.terms.values())])

    def hold(self) -> NDArray[np.float64]:
        """(N, A) the action that changes nothing now."""
        held = np.empty((self.num_envs, self.action_dim))
        for name, term in self.terms.items():
            held[:, self.slices[name]] = term.instance.hold()
        return held


def _bounded(low: NDArray[np.float32], high: NDArray[np.float32]) -> bool:
    return bool(np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all())
