"""What of a step is worth a plot, as the simulation's thread reads it; `metrics` encodes it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import StepRecord

__all__ = ["Scalars", "identifier"]

_FACTS = ("elapsed_steps", "success", "fail")
_GROUPS = (("rewards", "reward"), ("episode_sums", "sum"), ("metrics", "metric"))


class Scalars:
    """The scalars of a run, found in its first step: names and values.

    Args:
        step: Any step of the run.
        commands: Columns of commands by name, (N,) each: live views.
    """

    def __init__(self, step: StepRecord, commands: Mapping[str, Any] | None = None) -> None:
        self.names: list[str] = []
        self._commands = commands or {}
        for name in (identifier(path) for path, _ in self._walk(step)):
            taken = sum(n == name or n.startswith(f"{name}__") for n in self.names)
            self.names.append(f"{name}__{taken + 1}" if taken else name)

    def take(
        self,
        step: StepRecord,
        env_ids: NDArray[np.int64],
        weights: Mapping[str, float] | None = None,
    ) -> F64:
        """The scalars of some environments, (S, n), copied.

        Args:
            step: The step; one whose terms are others is refused.
            env_ids: (n,) environments.
            weights: Of the reward's terms: each is shown as it adds to the reward.

        Raises:
            ValueError: If the step has other scalars than the first one.
        """
        found = [values for _, values in self._walk(step)]
        if len(found) != len(self.names):
            raise ValueError(f"{len(found)} scalars in a step; the first had {self.names}")
        taken: F64 = np.empty((len(found), len(env_ids)))
        for row, values in enumerate(found):
            taken[row] = (values.numpy() if hasattr(values, "numpy") else values)[env_ids]
        if weights:
            first = 3 + sum(key in step.info for key in _FACTS)  # where `_walk` is at the terms
            terms = sorted(step.info.get("rewards", {}))
            factors = [weights.get(name, 1.0) for name in terms]
            taken[first : first + len(terms)] *= np.array(factors)[:, None]
        return taken

    def _walk(self, step: StepRecord) -> Iterator[tuple[str, Any]]:
        """Name and (N,) values of everything worth a plot, in a fixed order."""
        yield "reward", step.reward
        yield "terminated", step.terminated
        yield "truncated", step.truncated
        for key in _FACTS:
            if key in step.info:
                yield key, step.info[key]
        for key, prefix in _GROUPS:
            group: Mapping[str, Any] = step.info.get(key, {})
            for name in sorted(group):
                yield f"{prefix}_{name}", group[name]
        for name, values in self._commands.items():
            yield f"command_{name}", values


def identifier(name: str) -> str:
    """A legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()
