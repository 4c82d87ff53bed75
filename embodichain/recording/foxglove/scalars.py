"""What of a step is worth a plot, as the simulation's thread reads it; `metrics` encodes it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.term_rows import TermRows
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
        commands: Names of commands' columns, and their values, (N, columns): live.
    """

    def __init__(
        self, step: StepRecord, commands: Iterable[tuple[Sequence[str], F64]] = ()
    ) -> None:
        self.names: list[str] = []
        self._labels: list[str] = []
        self._commands: list[F64] = []
        for labels, values in commands:
            self._labels += labels
            self._commands.append(values)
        self._weights: Mapping[str, float] | None = None
        self._factors: F64 = np.zeros((0, 1))
        self._keys = [key for key in _FACTS if key in step.info]
        self._terms = {key: list(step.info.get(key, {})) for key, _ in _GROUPS}
        for name in map(identifier, self._titles()):
            taken = sum(n == name or n.startswith(f"{name}__") for n in self.names)
            self.names.append(f"{name}__{taken + 1}" if taken else name)

    def _titles(self) -> Iterator[str]:
        yield from ("reward", "terminated", "truncated")
        yield from self._keys
        for key, prefix in _GROUPS:
            for name in self._terms[key]:
                yield f"{prefix}_{name}"
        for label in self._labels:
            yield f"command_{label}"

    def take(
        self,
        step: StepRecord,
        env_ids: NDArray[np.int64],
        weights: Mapping[str, float] | None = None,
    ) -> F64:
        """The scalars of some environments, (S, n), copied.

        Args:
            step: The step; one whose terms are others is refused.
            env_ids: (n,) environments, ascending, at least one.
            weights: Of the reward's terms: each is shown as it adds to the reward.

        Raises:
            ValueError: If the step has other scalars than the first one.
        """
        first, last = int(env_ids[0]), int(env_ids[-1])
        side_by_side = last - first + 1 == len(env_ids)  # slices cost half of what indices do
        which: Any = slice(first, last + 1) if side_by_side else env_ids
        info = step.info
        taken: F64 = np.empty((len(self.names), len(env_ids)))
        taken[0], taken[1] = step.reward[which], step.terminated[which]
        taken[2] = step.truncated[which]
        at = 3
        try:
            for key in self._keys:
                taken[at] = _array(info[key])[which]
                at += 1
            for key, names in self._terms.items():
                if names:
                    end = at + len(names)
                    _take_group(info.get(key, {}), names, which, taken[at:end])
                    if key == "rewards" and weights:
                        taken[at:end] *= self._factors_of(weights)
                    at = end
        except KeyError as error:
            raise ValueError(
                f"a step's scalars are not those of the first one: {self.names}"
            ) from error
        for command in self._commands:
            end = at + command.shape[1]
            taken[at:end] = command[which].T
            at = end
        return taken

    def _factors_of(self, weights: Mapping[str, float]) -> F64:
        """(T, 1) weights of the reward's terms."""
        if self._weights != weights:
            self._weights = dict(weights)
            factors = [weights.get(name, 1.0) for name in self._terms["rewards"]]
            self._factors = np.array(factors)[:, None]
        return self._factors


def _take_group(group: Mapping[str, Any], names: list[str], which: Any, out: F64) -> None:
    """Environments of (N,) values of T terms into (T, n); KeyError if the terms are others."""
    if len(group) != len(names):
        raise KeyError(names)
    if isinstance(group, TermRows) and list(group) == names:
        out[:] = group.rows[:, which]
    else:
        for row, name in zip(out, names, strict=True):
            row[:] = _array(group[name])[which]


def _array(value: Any) -> Any:
    return value.numpy() if isinstance(value, torch.Tensor) else value


def identifier(name: str) -> str:
    """A legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()
