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
        self._keys = [key for key in _FACTS if key in step.info]
        self._terms = {key: sorted(step.info.get(key, {})) for key, _ in _GROUPS}
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
        found = self._found(step)
        taken: F64 = np.empty((len(found), len(env_ids)))
        first, last = int(env_ids[0]), int(env_ids[-1])
        side_by_side = last - first + 1 == len(env_ids)  # slices cost half of what indices do
        which: Any = slice(first, last + 1) if side_by_side else env_ids
        for row, values in enumerate(found):
            taken[row] = (values.numpy() if hasattr(values, "numpy") else values)[which]
        terms = self._terms["rewards"]
        if weights and terms:
            at = 3 + len(self._keys)
            factors = [weights.get(name, 1.0) for name in terms]
            taken[at : at + len(terms)] *= np.array(factors)[:, None]
        return taken

    def _found(self, step: StepRecord) -> list[Any]:
        """(N,) values of everything worth a plot, in the order of the names."""
        info = step.info
        found: list[Any] = [step.reward, step.terminated, step.truncated]
        try:
            found += [info[key] for key in self._keys]
            for key, names in self._terms.items():
                group = info.get(key, {})
                if len(group) != len(names):
                    raise KeyError(key)
                found += [group[name] for name in names]
        except KeyError as error:
            raise ValueError(
                f"a step's scalars are not those of the first one: {self.names}"
            ) from error
        found += self._commands.values()
        return found


def identifier(name: str) -> str:
    """A legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()
