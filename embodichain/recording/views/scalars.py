"""`/env_I/metrics`: the numbers of a step as flat fields, in a message declared for the run.

Every plotting tool draws flat fields; which there are depends on the task's terms.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.term_rows import TermRows
from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.engine.layout import as_slice
from embodichain.recording.schema import scalars_class, scalars_descriptor_set

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import StepRecord
    from embodichain.recording.views.markers import Commands

__all__ = ["METRICS", "Scalars", "identifier"]

METRICS = "Metrics"
"""Name of the message."""
_FACTS = ("elapsed_steps", "success", "fail")
_GROUPS = (("rewards", "reward"), ("episode_sums", "sum"), ("metrics", "metric"))


class Scalars:
    """The scalars of a run, found in its first step.

    Args:
        step: Any step of the run.
        env_ids: (n,) viewed environments, ascending, at least one.
        commands: The commands, whose values are scalars too.
    """

    def __init__(self, step: StepRecord, env_ids: NDArray[np.int64], commands: Commands) -> None:
        self._which = as_slice(env_ids)
        found = commands.scalars()
        self._commands = [values for _, values in found]
        self._facts = [key for key in _FACTS if key in step.info]
        self._terms = {key: list(step.info.get(key, {})) for key, _ in _GROUPS}
        self.names: list[str] = []
        """Of the fields, S of them."""
        for name in map(identifier, self._titles([name for names, _ in found for name in names])):
            taken = sum(n == name or n.startswith(f"{name}__") for n in self.names)
            self.names.append(f"{name}__{taken + 1}" if taken else name)
        self._shape = len(self.names), len(env_ids)
        self._factors = np.ones((len(self.names), 1))
        self._weighted = False
        self._weights: object = None  # those in `_factors`
        self._message = scalars_class(METRICS, self.names)

    def _titles(self, commands: list[str]) -> Iterator[str]:
        yield from ("reward", "terminated", "truncated", *self._facts)
        for key, prefix in _GROUPS:
            yield from (f"{prefix}_{name}" for name in self._terms[key])
        yield from (f"command_{name}" for name in commands)

    @property
    def descriptor_set(self) -> bytes:
        """Schema of the message."""
        return scalars_descriptor_set(METRICS, self.names)

    def weigh(self, weights: Mapping[str, float]) -> None:
        """Multiply reward terms with these weights from now on, as they add to the reward."""
        if weights is not self._weights:
            self._weights = weights
            first = 3 + len(self._facts)
            for at, name in enumerate(self._terms["rewards"], first):
                self._factors[at] = weights.get(name, 1.0)
            self._weighted = bool((self._factors != 1.0).any())

    def take(self, step: StepRecord) -> F64:
        """Return the scalars, (S, n), copied.

        Raises:
            ValueError: If the step has other scalars than the first one.
        """
        which, info = self._which, step.info
        taken: F64 = np.empty(self._shape)
        taken[0], taken[1] = step.reward[which], step.terminated[which]
        taken[2] = step.truncated[which]
        at = 3
        try:
            for key in self._facts:
                taken[at] = _array(info[key])[which]
                at += 1
            for key, names in self._terms.items():
                group: Mapping[str, Any] = info.get(key, {})
                if len(group) != len(names):
                    raise KeyError(names)
                if isinstance(group, TermRows) and list(group) == names:  # all at once
                    taken[at : at + len(names)] = group.rows[:, which]
                    at += len(names)
                    continue
                for name in names:
                    taken[at] = _array(group[name])[which]
                    at += 1
        except KeyError as error:
            raise ValueError(
                f"a step's scalars are not those of the first one: {self.names}"
            ) from error
        for command in self._commands:
            end = at + command.shape[1]
            taken[at:end] = command[which].T
            at = end
        if self._weighted:
            taken *= self._factors
        return taken

    def encode(self, step: StepRecord) -> list[bytes]:
        """Return the serialized message of each viewed environment."""
        return [
            self._message(**dict(zip(self.names, values, strict=True))).SerializeToString()
            for values in self.take(step).T.tolist()
        ]


def _array(value: Any) -> Any:
    return value.numpy() if isinstance(value, torch.Tensor) else value


def identifier(name: str) -> str:
    """Return a legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()
