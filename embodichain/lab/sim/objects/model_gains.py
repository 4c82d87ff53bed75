"""What gains the fields of a model stand for, which hold products of gain and strength."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler import ParsedArticulation
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.objects.transmission import Transmission

__all__ = ["NO_EFFORT_LIMIT", "NO_LIMIT", "ModelGains"]

NO_LIMIT = 1e9
"""Efforts at least this large count as unlimited (EmbodiChain's default is 1e10)."""
NO_EFFORT_LIMIT = 1e10


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
        effort = np.where(limited == 0, NO_EFFORT_LIMIT, effort)
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
