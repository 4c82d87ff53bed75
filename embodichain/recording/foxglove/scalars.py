"""What of a step is worth a plot, as the simulation's thread reads it; `metrics` encodes it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
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
        for name in self._commands:
            yield f"command_{name}"

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
        facts: list[Any] = [step.reward, step.terminated, step.truncated]
        try:
            facts += [step.info[key] for key in self._keys]
            terms = [value for key in self._terms for value in self._group(step.info, key)]
        except KeyError as error:
            raise ValueError(
                f"a step's scalars are not those of the first one: {self.names}"
            ) from error
        taken: F64 = np.empty((len(self.names), len(env_ids)))
        ends = len(facts), len(facts) + len(terms)
        rewards = self._terms["rewards"]
        _one_by_one(facts, which, taken[: ends[0]])
        _together(terms, which, taken[ends[0] : ends[1]])
        _one_by_one(self._commands.values(), which, taken[ends[1] :])
        if weights and rewards:
            factors = np.array([weights.get(name, 1.0) for name in rewards])
            taken[ends[0] : ends[0] + len(rewards)] *= factors[:, None]
        return taken

    def _group(self, info: Mapping[str, Any], key: str) -> Iterable[Any]:
        """(N,) values of a group's terms; KeyError if they are not those of the first step."""
        names = self._terms[key]
        group: Mapping[str, Any] = info.get(key, {})
        if list(group) == names:
            return group.values()
        if len(group) != len(names):
            raise KeyError(key)
        return [group[name] for name in names]


def _together(values: list[Any], which: Any, out: F64) -> None:
    """Environments of (N,) values of T terms into (T, n)."""
    if {getattr(v, "dtype", None) for v in values} == {torch.float32}:
        out[:] = torch.stack(values).numpy()[:, which]  # a third of what they cost one by one
    else:
        _one_by_one(values, which, out)


def _one_by_one(values: Iterable[Any], which: Any, out: F64) -> None:
    for row, one in zip(out, values, strict=True):
        row[:] = (one.numpy() if isinstance(one, torch.Tensor) else one)[which]


def identifier(name: str) -> str:
    """A legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()
