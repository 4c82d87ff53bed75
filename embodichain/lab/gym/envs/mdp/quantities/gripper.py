"""Quantities of grippers: the opening between two fingers, and whether they hold an object."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Body, ContactOf, NonNegative
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import norm, total
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = ["grasped", "gripper_opening"]

_OPPOSED = -0.5
"""Largest cosine between opposing forces: at least 120 degrees apart."""


@quantity()
def gripper_opening(env: TermContext, from_: Body, to: Body, closed: float = 0.0) -> Floats:
    """(N,) opening between two fingers, m: the distance of their links less that when closed.

    Args:
        closed: The distance of the links' origins when the gripper is closed, m.

    Example:
        ``{func: gripper_opening, params: {from: {uid: panda, link_names: [panda_leftfinger]},
        to: {uid: panda, link_names: [panda_rightfinger]}}}``
    """
    return from_.distance_to(to) - closed


@quantity()
def grasped(env: TermContext, sensor: ContactOf, threshold: NonNegative = 1.0) -> NDArray[np.bool_]:
    """(N,) True where both fingers press on an object from opposite sides.

    Each finger feels more than the threshold, and the forces are at least 120 degrees apart.

    Args:
        sensor: A contact sensor on the two fingers, `against` the object.
        threshold: N.

    Raises:
        ConfigError: If the sensor is not on two links.

    Example:
        ``{func: grasped, params: {sensor: fingers, threshold: 2.0}}``
    """
    if len(sensor.names) != 2:
        message = f"must be a contact sensor on two fingers; it is on {', '.join(sensor.names)}"
        raise ConfigError([Problem("sensor", message)])
    forces = sensor.read_force()
    left_force, right_force = forces.swapaxes(0, 1)
    left, right = norm(forces).T
    both_press = (left > threshold) & (right > threshold)
    are_opposed = total(left_force * right_force) < _OPPOSED * left * right
    return both_press & are_opposed
