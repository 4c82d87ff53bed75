"""Which devices physics may run on."""

from __future__ import annotations

from typing import Any

import torch

from embodichain.utils.errors import DeviceError
from embodichain.utils.suggest import did_you_mean

__all__ = ["check_device"]


def check_device(device: Any) -> torch.device:
    """Return the torch device a simulation may run on.

    Raises:
        DeviceError: If the name is unknown, or the device has no engine here.
    """
    try:
        found = torch.device(device)
    except RuntimeError:
        raise DeviceError(
            f"unknown device {device!r}; allowed: cpu.{did_you_mean(str(device), ['cpu', 'cuda'])}"
        ) from None
    if found.type == "cuda":
        raise DeviceError(
            f"device {str(device)!r}: the CUDA engine is not available yet; use device=cpu"
        )
    if found.type != "cpu":
        raise DeviceError(f"device {str(device)!r} has no physics engine; allowed: cpu")
    return found
