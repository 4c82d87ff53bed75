"""`ActionManager`: each action term receives its slice of the action.

Terms are in `envs/mdp/actions`, delay and noise in `action_pipeline.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.gym.envs.managers.manager import BuiltTerm, Manager
from embodichain.lab.gym.envs.managers.pipeline import ActionPipeline
from embodichain.lab.gym.envs.managers.term import ActionTerm
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex

__all__ = ["ActionManager", "ActionTerm"]  # EmbodiChain has both here


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

    def __init__(self, env: TermContext, cfgs: Mapping[str, ActionTermCfg]) -> None:
        self.slices: dict[str, slice] = {}
        self._pipelines: dict[str, ActionPipeline] = {}
        super().__init__(env, "actions", "action", cfgs)

    def _bind(self) -> None:
        known, self.slices = self.slices, {}
        start = 0
        lows: list[NDArray[np.float32]] = [np.zeros(0, np.float32)]
        highs: list[NDArray[np.float32]] = [np.zeros(0, np.float32)]
        for name, term in self.terms.items():
            low, high = _bounds_of(name, term)
            self.slices[name] = slice(start, start + len(low))
            start += len(low)
            lows.append(low)
            highs.append(high)
        low, high = np.concatenate(lows), np.concatenate(highs)
        if known and not (np.array_equal(low, self.low) and np.array_equal(high, self.high)):
            raise ConfigError([Problem("actions", "the action space cannot change while it runs")])
        self.action_dim = start
        self.low: NDArray[np.float32] = low
        self.high: NDArray[np.float32] = high
        self._calls = [(self._receiver(n, t), self.slices[n]) for n, t in self.terms.items()]

    def _receiver(self, name: str, term: BuiltTerm[ActionTermCfg]) -> Callable[..., Any]:
        """What takes a term's slice: without delay and noise, the term itself."""
        call, cfg = term.call, term.cfg
        if cfg.delay == 0 and cfg.noise is None:
            return call
        pipeline = self._pipelines.get(name)
        if pipeline is None:
            pipeline = ActionPipeline(name, cfg, term.instance.action_dim, self.env.streams)
            self._pipelines[name] = pipeline
        pipeline.hold = term.instance.hold
        return lambda action: call(pipeline(action))

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Reset terms, and what delays their actions; (n,) environments, or None for all."""
        super().reset(env_ids)
        for pipeline in self._pipelines.values():
            pipeline.reset(env_ids)

    def state_dict(self) -> dict[str, Any]:
        """State of terms and of actions under way (copies)."""
        under_way = {name: p.state_dict() for name, p in self._pipelines.items()}
        return {**super().state_dict(), "pipelines": under_way}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        for name, pipeline in self._pipelines.items():
            pipeline.load_state_dict(state["pipelines"][name])

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


def _bounds_of(
    name: str, term: BuiltTerm[ActionTermCfg]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(A,) low and high of a term.

    Raises:
        ConfigError: If there are none, or they are not finite and ordered.
    """
    instance = term.instance
    if not hasattr(instance, "low") or not hasattr(instance, "high"):
        message = f"{term.spec.label} must set low and high"
        raise ConfigError([Problem(f"actions.{name}.func", message)])
    low, high = (np.asarray(bound, np.float32) for bound in (instance.low, instance.high))
    width = int(instance.action_dim)
    finite = np.isfinite(low).all() and np.isfinite(high).all()
    if low.shape != (width,) or high.shape != (width,) or not finite or not (low < high).all():
        message = f"needs finite bounds low < high of shape ({width},), got {low}, {high}"
        raise ConfigError([Problem(f"actions.{name}", message)])
    return low, high
