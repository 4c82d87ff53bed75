"""`TerminationManager`: which environments end their episode, and why.

Terms are in `envs/mdp/terminations`. The limit `max_episode_steps` is the environment's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import TerminationCfg
from embodichain.lab.gym.envs.managers.base import Manager, checked_rows
from embodichain.lab.gym.envs.managers.term_rows import TermRows

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext

__all__ = ["TerminationManager"]

Masks = dict[str, NDArray[np.bool_]]


class TerminationManager(Manager[TerminationCfg]):
    """Joins the terms of each kind by "or".

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> termination.

    Attributes:
        values: Name -> (N,) bool of the last step; empty before the first.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, TerminationCfg]) -> None:
        super().__init__(env, "terminations", "termination", cfgs)
        self._names = tuple(self.terms)
        self.values = TermRows(())

    def _bind(self) -> None:
        self._checked = False
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
        values: list[NDArray[np.bool_]] = []
        for name, call, kind in self._calls:
            value = call(self.env, obs, action, info)
            if not self._checked:
                checked_rows(value, self.num_envs, "termination", name)
            flags = value if type(value) is np.ndarray else value.numpy(force=True)
            flags = flags.astype(np.bool_)  # a copy: the term may reuse its own
            values.append(flags)
            masks[kind] = masks[kind] | flags if kind in masks else flags
        self._checked = True
        self.values = TermRows(self._names, values)
        return masks
