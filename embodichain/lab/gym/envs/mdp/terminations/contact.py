"""Terminations of contacts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import NonNegative
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.mdp import _sensors
from embodichain.lab.gym.envs.mdp._judge import Judge, any_column

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext

__all__ = ["IllegalContact"]


@register_term("termination", "metric", name="illegal_contact")
class IllegalContact(Judge, _sensors.ReadsContact):
    """True where a link of a sensor is touched by more than a force. Isaac Lab's of the same name.

    The force is the length of the net contact force on one link in the last physics step.

    Args:
        sensor: A contact sensor on the links that must not touch anything.
        threshold: N.

    Example:
        ``{func: illegal_contact, kind: fail, params: {sensor: contacts, threshold: 1.0}}``
    """

    def __init__(self, env: TermContext, sensor: str, threshold: NonNegative = 1.0) -> None:
        self._sensor, self._threshold = _sensors.contact(env, sensor), threshold

    def value(self) -> NDArray[np.bool_]:
        """(N,) bool."""
        return any_column(_sensors.magnitude(self._sensor.read_force()) > self._threshold)
