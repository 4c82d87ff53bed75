"""`Computed`: observation terms whose value is one float64 array, made a tensor once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp import _spatial

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["Computed"]


class Computed(Term):
    """A term that subclasses give its `value`."""

    def value(self) -> F64:
        """(N, ...) float64."""
        raise NotImplementedError

    def __call__(self, env: TermContext, obs: Any) -> torch.Tensor:
        """(N, ...) float32, a tensor of its own."""
        return _spatial.tensor(self.value())
