"""`/env_I/metrics`: the numbers of a step as flat scalars, in a message declared for this run.

Flat fields are what every plotting tool can draw; which there are depends on the task's terms.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from embodichain.lab.gym.envs.observers import StepRecord
from embodichain.recording import wire

__all__ = ["Scalars", "identifier"]


class Scalars:
    """The scalars of a run, found in its first step: names, schema, values.

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

    def encode(self, step: StepRecord, env_id: int) -> bytes:
        """The scalars of one environment; a step whose terms are others is refused.

        Raises:
            ValueError: If the step has other scalars than the first one.
        """
        values = [float(np.asarray(value)[env_id]) for _, value in self._walk(step)]
        if len(values) != len(self.names):
            raise ValueError(f"{len(values)} scalars in a step; the first had {self.names}")
        return b"".join(
            wire.varint(number << 3 | 1) + struct.pack("<d", value)
            for number, value in enumerate(values, start=1)
            if value != 0.0
        )

    def _walk(self, step: StepRecord) -> Iterator[tuple[str, Any]]:
        """Name and (N,) values of everything worth a plot, in a fixed order."""
        yield "reward", step.reward
        yield "terminated", step.terminated
        yield "truncated", step.truncated
        for key in ("elapsed_steps", "success", "fail"):
            if key in step.info:
                yield key, step.info[key]
        for key, prefix in (("rewards", "reward"), ("episode_sums", "sum"), ("metrics", "metric")):
            group: Mapping[str, Any] = step.info.get(key, {})
            for name in sorted(group):
                yield f"{prefix}_{name}", group[name]
        for name, values in self._commands.items():
            yield f"command_{name}", values


def identifier(name: str) -> str:
    """A legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()
