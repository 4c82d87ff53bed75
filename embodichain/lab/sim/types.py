"""Names for the arrays and devices that cross the Python API. This module imports torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from embodichain.utils.tensor_mapping import TensorMapping

__all__ = ["Array", "Device", "EnvAction", "EnvObs"]

Array = torch.Tensor | np.ndarray[Any, Any] | Sequence[Any]
Device = str | torch.device
EnvObs = TensorMapping
"""Nested tensors (N, ...)."""
EnvAction = torch.Tensor | Mapping[str, torch.Tensor]
