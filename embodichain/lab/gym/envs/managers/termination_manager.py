"""`TerminationManager`: which environments end their episode, and why.

The terms themselves are in `envs/mdp/terminations.py`. The time limit `max_episode_steps` is the
environment's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader

from embodichain.lab.gym.envs.cfg import TerminationCfg
from embodichain.lab.gym.envs.managers.base import Manager, checked_rows

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
else:
    torch = lazy_loader.load("torch")

__all__ = ["TerminationManager"]

Masks = dict[str, "torch.Tensor"]


class TerminationManager(Manager[TerminationCfg]):
    """Joins the terms of each kind by "or".

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> termination.

    Attributes:
        values: Name -> (N,) bool of the last step: which term ended what.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, TerminationCfg]) -> None:
        super().__init__(env, "terminations", "termination", cfgs)
        self.values: Masks = {}
        self._checked = False

    def _bind(self) -> None:
        self._calls = [(name, t.call, t.cfg.kind) for name, t in self.terms.items()]

    @property
    def has_success(self) -> bool:
        """Whether a term of kind ``success`` exists."""
        return any(kind == "success" for _, _, kind in self._calls)

    def compute(self, obs: Any, action: Any, info: dict[str, Any]) -> Masks:
        """Evaluate every term of this step.

        Args:
            obs: The step's observation.
            action: The step's action.
            info: What `evaluate` gave, and ``elapsed_steps``.

        Returns:
            (N,) bool masks by kind, ``success``, ``fail``, ``time_out``; kinds without a term are
            absent. Success and fail terminate, time_out truncates.

        Raises:
            ValueError: If a term's value has another shape than (N,); names the term.
        """
        masks: Masks = {}
        if not self._calls:
            return masks
        values: Masks = {}
        for name, call, kind in self._calls:
            value = call(self.env, obs, action, info)
            if not self._checked:
                checked_rows(value, self.num_envs, "termination", name)
            if value.dtype != torch.bool:
                value = value != 0
            values[name] = value
            masks[kind] = masks[kind] | value if kind in masks else value
        self._checked = True
        self.values = values
        return masks
