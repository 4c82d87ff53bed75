"""`/env_I/metrics`: the numbers of a step as flat fields, in a message declared for the run.

Every plotting tool draws flat fields; which there are depends on the task's terms.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.value_managers import TermRows
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
        env_ids: Viewed environments.
        commands: The commands, whose values are scalars too.
    """

    def __init__(self, step: StepRecord, env_ids: Sequence[int], commands: Commands) -> None:
        self._ids = env_ids
        found = commands.scalars()
        self._commands = [values.T for _, values in found]
        self._facts = [key for key in _FACTS if key in step.info]
        self._terms = {key: list(step.info.get(key, {})) for key, _ in _GROUPS}
        self.names: list[str] = []
        """Of the fields, S of them."""
        for name in map(identifier, self._titles([name for names, _ in found for name in names])):
            taken = sum(n == name or n.startswith(f"{name}__") for n in self.names)
            self.names.append(f"{name}__{taken + 1}" if taken else name)
        self._factors: list[float] = []  # of the scalars; empty: all are 1
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
            factors = [1.0] * len(self.names)
            for at, name in enumerate(self._terms["rewards"], 3 + len(self._facts)):
                factors[at] = weights.get(name, 1.0)
            self._factors = factors if set(factors) != {1.0} else []

    def encode(self, step: StepRecord) -> list[bytes]:
        """Return the serialized message of each viewed environment.

        Raises:
            ValueError: If the step has other scalars than the first one.
        """
        try:
            blocks = self._blocks(step)
        except KeyError as error:
            raise ValueError(
                f"a step's scalars are not those of the first one: {self.names}"
            ) from error
        found = []
        for env_id in self._ids:
            values: list[float] = []
            for block in blocks:
                if block.ndim == 1:
                    values.append(block.item(env_id))
                else:
                    values += block[:, env_id].tolist()
            if self._factors:
                values = [a * b for a, b in zip(values, self._factors, strict=True)]
            message = self._message(**dict(zip(self.names, values, strict=True)))
            found.append(message.SerializeToString())
        return found

    def _blocks(self, step: StepRecord) -> list[NDArray[Any]]:
        """All scalars in order, as (N,) arrays or (K, N) of K scalars."""
        info = step.info
        blocks: list[NDArray[Any]] = [step.reward, step.terminated, step.truncated]
        blocks += [_array(info[key]) for key in self._facts]
        for key, names in self._terms.items():
            group: Mapping[str, Any] = info.get(key, {})
            if len(group) != len(names):
                raise KeyError(names)
            if isinstance(group, TermRows) and list(group) == names:
                blocks.append(group.rows)
            else:
                blocks += [_array(group[name]) for name in names]
        return blocks + self._commands


def _array(value: Any) -> NDArray[Any]:
    """Return a tensor or an array as an array."""
    array: NDArray[Any] = value if type(value) is np.ndarray else value.numpy()
    return array


def identifier(name: str) -> str:
    """Return a legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()
