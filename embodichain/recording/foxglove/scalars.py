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
from embodichain.lab.sim.engine.layout import as_slice

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import StepRecord

__all__ = ["Scalars", "identifier"]

_FACTS = ("elapsed_steps", "success", "fail")
_GROUPS = (("rewards", "reward"), ("episode_sums", "sum"), ("metrics", "metric"))


class Scalars:
    """The scalars of a run, found in its first step: names and values.

    Args:
        step: Any step of the run.
        env_ids: (n,) environments whose values are taken, ascending, at least one.
        commands: Names of commands' columns, and their values, (N, columns): live.
    """

    def __init__(
        self,
        step: StepRecord,
        env_ids: NDArray[np.int64],
        commands: Iterable[tuple[Sequence[str], F64]] = (),
    ) -> None:
        self._which = as_slice(env_ids)
        self.names: list[str] = []
        self._labels: list[str] = []
        self._commands: list[F64] = []
        for labels, values in commands:
            self._labels += labels
            self._commands.append(values)
        self._keys = [key for key in _FACTS if key in step.info]
        self._terms = {key: list(step.info.get(key, {})) for key, _ in _GROUPS}
        for name in map(identifier, self._titles()):
            taken = sum(n == name or n.startswith(f"{name}__") for n in self.names)
            self.names.append(f"{name}__{taken + 1}" if taken else name)
        self._shape = len(self.names), len(env_ids)
        self._known: dict[str, Iterable[str]] = {}  # of groups in rows, whose names were looked at

    def _titles(self) -> Iterator[str]:
        yield from ("reward", "terminated", "truncated")
        yield from self._keys
        for key, prefix in _GROUPS:
            for name in self._terms[key]:
                yield f"{prefix}_{name}"
        for label in self._labels:
            yield f"command_{label}"

    def factors(self, weights: Mapping[str, float]) -> F64:
        """(S,) what scalars are to be multiplied with: terms are shown as they add to the reward.

        Args:
            weights: Of the reward's terms.
        """
        factors = np.ones(len(self.names))
        first = 3 + len(self._keys)  # of the terms
        for at, name in enumerate(self._terms["rewards"], first):
            factors[at] = weights.get(name, 1.0)
        return factors

    def take(self, step: StepRecord) -> F64:
        """The scalars, (S, n), copied.

        Raises:
            ValueError: If the step has other scalars than the first one.
        """
        which, info = self._which, step.info
        taken: F64 = np.empty(self._shape)
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
                    self._take_group(key, info.get(key, {}), taken[at:end])
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

    def _take_group(self, key: str, group: Mapping[str, Any], out: F64) -> None:
        """(N,) values of T terms into (T, n); KeyError if the terms are others."""
        names, which = self._terms[key], self._which
        if len(group) != len(names):
            raise KeyError(names)
        rows: TermRows | None = group if isinstance(group, TermRows) else None
        if rows is not None and self._known.get(key) is not rows.names:
            if list(rows) == names:
                self._known[key] = rows.names
            else:
                rows = None
        if rows is not None:
            out[:] = rows.rows[:, which]
        else:
            for row, name in zip(out, names, strict=True):
                row[:] = _array(group[name])[which]


def _array(value: Any) -> Any:
    return value.numpy() if isinstance(value, torch.Tensor) else value


def identifier(name: str) -> str:
    """A legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()
