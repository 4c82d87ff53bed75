"""Check that networks and losses are finite; a training in which some are not ends with an error.

The check is made after each update, before a checkpoint could be written.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

import torch
from torch import Tensor

from embodichain.utils.errors import EmbodichainError

__all__ = [
    "Learning",
    "NoValidStepError",
    "NotFiniteError",
    "check_finite",
    "refused_by_torch",
    "told_apart",
]

_LARGEST_WEIGHT = 1e18
"""Products of larger numbers are beyond float32."""
_TORCH_MESSAGE = "Expected parameter"
"""Beginning of the message of torch's distributions about parameters that are not finite."""


class NotFiniteError(EmbodichainError):
    """Networks or losses of a training are NaN or infinite."""


class NoValidStepError(EmbodichainError):
    """No environment has taken a step whose physics, observation and rewards are finite."""


class Learning(Protocol):
    """A training that can be looked at.

    Attributes:
        env_steps: Environment steps taken, summed over environments.
        updates: Updates of the networks so far.
    """

    @property
    def env_steps(self) -> int:
        """Environment steps taken, summed over environments."""

    @property
    def updates(self) -> int:
        """Updates of the networks so far."""

    def parameters(self) -> Iterable[Tensor]:
        """Parameters of all networks."""

    def losses(self) -> Mapping[str, Any]:
        """The losses of the last update, and other numbers that it logged."""


def check_finite(training: Learning) -> None:
    """Check the networks and the losses of the last update.

    Raises:
        NotFiniteError: Some are not finite; says which, and after which update.
    """
    largest = _largest([p.detach() for p in training.parameters()])
    if not math.isfinite(largest):
        raise NotFiniteError(f"the networks are not finite {_when(training)}")
    if largest > _LARGEST_WEIGHT:
        message = f"the networks have weights of {largest:.1g}, what they give is not finite"
        raise NotFiniteError(f"{message} {_when(training)}")
    infinite_losses = [
        name
        for name, value in training.losses().items()
        if name.endswith("loss") and not math.isfinite(float(value))
    ]
    if infinite_losses:
        verb = "is" if len(infinite_losses) == 1 else "are"
        names = ", ".join(infinite_losses)
        raise NotFiniteError(f"{names} {verb} not finite {_when(training)}")


@contextmanager
def told_apart(training: Learning) -> Iterator[None]:
    """Say of an exception of an update that the networks are not finite, if that is why.

    Raises:
        NotFiniteError: Networks or losses are not finite, or torch refused what they gave.
    """
    try:
        yield
    except NotFiniteError:
        raise
    except (ValueError, RuntimeError) as error:
        try:
            check_finite(training)
        except NotFiniteError as reason:
            raise reason from error
        if refused_by_torch(error):
            message = f"what the networks give is not finite {_when(training)}"
            raise NotFiniteError(message) from error
        raise


def refused_by_torch(error: Exception) -> bool:
    """Whether an error is that of a distribution of torch about a mean or a spread that is NaN."""
    return isinstance(error, ValueError) and str(error).startswith(_TORCH_MESSAGE)


def _when(training: Learning) -> str:
    steps = training.env_steps
    return f"in update {training.updates:,}, after {steps:,} environment steps"


def _largest(tensors: list[Tensor]) -> float:
    """Return a limit of the absolute values, exact above `_LARGEST_WEIGHT`; NaN if there is one."""
    tensors = [tensor for tensor in tensors if tensor.numel()]
    if not tensors:
        return 0.0
    # Norms are a hundred times as fast as the largest values, and never below them.
    norms = torch._foreach_norm(tensors)
    largest_norm = float(torch.stack([norm.float() for norm in norms]).max())
    if largest_norm <= _LARGEST_WEIGHT:
        return largest_norm
    return float(torch.stack([tensor.abs().max().float() for tensor in tensors]).max())
