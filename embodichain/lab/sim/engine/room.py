"""What the simulations of a batch need of memory, at least."""

from __future__ import annotations

import mujoco

__all__ = ["LEAST_BYTES", "bytes_of"]

_COPIES = 4
"""Rows of float64 an environment: the state, its outputs and copies of them. Measured: 3.4 on reach
(3 kB), 4 on cart_pole (1.7 kB), with handles, observations and buffers of the episode."""
LEAST_BYTES = 512
"""Of an environment of any scene: a row has 13 numbers and more, and the episode its counters."""


def bytes_of(model: mujoco.MjModel, persistent: bool | None) -> int:
    """Bytes that one environment of a batch on the host needs at least.

    Args:
        model: The compiled scene.
        persistent: Whether each environment has an `MjData` of its own.
    """
    numbers = int(mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_INTEGRATION)))
    data_bytes = int(mujoco.MjData(model).nbuffer) if persistent else 0
    return max(LEAST_BYTES, 8 * _COPIES * numbers + data_bytes)
