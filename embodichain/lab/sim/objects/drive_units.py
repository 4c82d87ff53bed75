"""Drives in the units of their actuators: `Transmission`, and `ModelGains`, which reads them back.

Our drives act on the joint as it is. A servo of an MJCF file has a gear, ``length = gear * q``,
and its control may be in other units than its length: ``ctrl = scale * target``. With the joint's
stiffness k, damping d and control gain g (``force = g * target - k * q - d * qvel``), those of the
actuator are ``k / gear**2``, ``d / gear**2`` and ``g / (gear * scale)``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drive_cfg import NO_LIMIT

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.articulation import ParsedArticulation
    from embodichain.lab.sim.compiler.robot_joints import Servos
    from embodichain.lab.sim.engine.base import F64

__all__ = ["ModelGains", "Transmission"]

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


class ModelGains:
    """Reads properties of an articulation out of model fields that differ from the compiled ones.

    Args:
        model: As compiled.
        fields: Name -> (size,) values; absent ones are as compiled.
    """

    def __init__(self, model: mujoco.MjModel, fields: Mapping[str, NDArray[Any]]) -> None:
        self._model, self._fields = model, fields

    def read(
        self,
        name: str,
        columns: NDArray[np.int64],
        declared: Any,
        unit: Callable[[F64], F64] | None = None,
    ) -> F64:
        """(k,) columns of a flattened field; where nothing changed the declared values.

        Args:
            name: The field.
            columns: (k,) of it.
            declared: (k,) what the compiled values stand for.
            unit: From the field's unit to that of `declared`.
        """
        compiled = np.asarray(getattr(self._model, name), np.float64).reshape(-1)[columns]
        now = compiled
        if name in self._fields:
            now = np.asarray(self._fields[name], np.float64).reshape(-1)[columns]
        value = now if unit is None else unit(now)
        return np.where(now == compiled, np.asarray(declared, np.float64), value)

    def drives(
        self,
        parsed: ParsedArticulation,
        transmission: Transmission,
        actuators: NDArray[np.int64],
        joints: NDArray[np.int64],
    ) -> dict[str, F64]:
        """Strength, stiffness, damping and effort limit, (k,) each, of drives.

        Where gains and effort limit are scaled alike, or only a limit is there, strength is what
        scaled them; else it is taken as 1.

        Args:
            parsed: What was declared.
            transmission: Between joints and actuators.
            actuators: (k,) the drives.
            joints: (k,) their joints.
        """
        springs = np.asarray(parsed.stiffness, np.float64)[joints]
        dampers = np.asarray(parsed.damping, np.float64)[joints]
        most = np.asarray(parsed.max_effort, np.float64)[joints]
        bias = self._model.actuator_biasprm.shape[1] * actuators

        def gain(values: F64) -> F64:
            return transmission.feedback_of(values, joints)

        stiffness = self.read("actuator_biasprm", bias + 1, springs, gain)
        damping = self.read("actuator_biasprm", bias + 2, dampers, gain)
        effort = self.read(
            "actuator_forcerange",
            2 * actuators + transmission.larger_side(joints),
            most,
            lambda bound: transmission.effort_of(bound, joints),
        )
        limited = self.read("actuator_forcelimited", actuators, -1.0)
        effort = np.where(limited == 0, 1e10, effort)
        scale = np.divide(
            effort, most, out=np.ones_like(most), where=(most > 0) & (most < NO_LIMIT)
        )
        alike = np.ones_like(scale, np.bool_)
        for now, declared in ((stiffness, springs), (damping, dampers)):
            factor = np.divide(now, declared, out=scale.copy(), where=declared > 0)
            alike &= np.isclose(scale, factor, rtol=1e-9, atol=0.0)
        return {
            "strength": np.where(alike, scale, 1.0),
            "stiffness": np.where(alike, springs, stiffness),
            "damping": np.where(alike, dampers, damping),
            "max_effort": np.where(alike, most, effort),
        }
