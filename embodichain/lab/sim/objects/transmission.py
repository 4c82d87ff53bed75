"""`Transmission`: what a joint's drive is in the units of the actuator that carries it.

Our drives act on the joint as it is. A servo of an MJCF file has a gear, ``length = gear * q``,
and its control may be in other units than its length: ``ctrl = scale * target``. With the joint's
stiffness k, damping d and control gain g (``force = g * target - k * q - d * qvel``), those of the
actuator are ``k / gear**2``, ``d / gear**2`` and ``g / (gear * scale)``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.actuators import Servos
    from embodichain.lab.sim.engine.base import F64

__all__ = ["Transmission"]

Joints = NDArray[np.int64]


class Transmission:
    """Converts numbers of D joints, each method for some of them (k,), to their actuators'.

    Attributes:
        scales: Whether a control is something else than a target anywhere.
    """

    def __init__(self, servos: Servos) -> None:
        self._gear, self._scale, self._shares = servos.gear, servos.scale, servos.shares
        self.scales = bool((self._scale != 1).any())

    def control(self, target: F64, joints: Joints) -> F64:
        """(n, k) controls of targets."""
        return target * self._scale[joints] if self.scales else target

    def target(self, control: F64, joints: Joints) -> F64:
        """(n, k) targets of controls."""
        return control / self._scale[joints] if self.scales else control

    def gain(self, gain: F64, joints: Joints) -> F64:
        """(n, k) ``gainprm[0]`` of control gains."""
        return gain / (self._gear * self._scale)[joints]

    def feedback(self, gain: F64, joints: Joints) -> F64:
        """(n, k) ``-biasprm[1]`` of stiffness, ``-biasprm[2]`` of damping."""
        return gain / self._gear[joints] ** 2

    def feedback_of(self, bias: F64, joints: Joints) -> F64:
        """(k,) stiffness or damping of ``biasprm``."""
        return np.abs(bias) * self._gear[joints] ** 2

    def force_range(self, effort: F64, joints: Joints) -> tuple[F64, F64]:
        """(n, k) lower and upper ``forcerange`` of effort limits; a file's may be uneven."""
        most = effort / np.abs(self._gear[joints])
        low, high = self._shares[joints].T
        return -most * low, most * high

    def larger_side(self, joints: Joints) -> NDArray[np.int64]:
        """(k,) column of ``forcerange`` that holds the limit itself: 1, or 0."""
        low, high = self._shares[joints].T
        return np.where(high >= low, 1, 0)

    def effort_of(self, bound: F64, joints: Joints) -> F64:
        """(k,) effort limit of the larger side of ``forcerange``."""
        return np.abs(bound) * np.abs(self._gear[joints])
