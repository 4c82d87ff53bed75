"""`/env_I/metrics`: the numbers of a step as flat scalars, in a message declared for this run.

Flat fields are what every plotting tool can draw; which there are depends on the task's terms.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording import wire
from embodichain.recording.foxglove.template import Template, mark
from embodichain.recording.schemas import scalars_descriptor_set

__all__ = ["Metrics"]


class Metrics:
    """The message of a run.

    Args:
        names: Its fields, all float64.
    """

    SCHEMA = "embodichain.Metrics"

    def __init__(self, names: Sequence[str]) -> None:
        self.descriptor_set = scalars_descriptor_set("Metrics", names)
        fields = [
            wire.varint(number << 3 | 1) + struct.pack("<d", mark(number - 1))
            for number in range(1, len(names) + 1)
        ]
        self._template = Template(b"".join(fields), len(fields))

    def table(self, taken: F64) -> NDArray[np.uint8]:
        """(L, n, bytes) messages of (L, S, n) numbers."""
        moments, scalars, count = taken.shape
        values = taken.transpose(0, 2, 1).reshape(-1, scalars)
        return self._template.table(values).reshape(moments, count, -1)
