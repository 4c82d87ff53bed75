"""Names for the arrays and devices that cross the Python API. This module imports torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Union

import numpy as np
import torch
from tensordict import TensorDict

__all__ = ["Array", "Device", "EnvAction", "EnvIds", "EnvObs"]

Array = Union[torch.Tensor, np.ndarray, Sequence[Any]]
Device = Union[str, torch.device]
EnvIds = Union[torch.Tensor, np.ndarray, Sequence[int], None]
"""Sorted, unique environment indices, or a boolean mask of length N; None is all of them."""
EnvObs = TensorDict
EnvAction = Union[torch.Tensor, TensorDict]
