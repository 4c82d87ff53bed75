"""Events that change joints and their drives: gains, friction, armature, limits, efforts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Ranges
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._model_fields import (
    Distribution,
    Draw,
    Operation,
    Quantity,
    articulation_of,
    driven_joints,
)
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["RandomizeActuatorGains", "RandomizeEffortLimits", "RandomizeJointParameters"]


class _Drives(Term):
    """Draws properties that the articulation's drives keep; names are those of `Drives.put`."""

    def __init__(
        self,
        entity: ResolvedEntity,
        joints: NDArray[np.int64],
        ranges: dict[str, Ranges | None],
        operation: Operation,
        distribution: Distribution,
        puts: dict[str, str],
    ) -> None:
        asset = entity.asset
        self._drives = asset.drives
        names = [asset.parsed.joint_names[i] for i in joints]
        quantities = [
            Quantity(
                param,
                given,
                names,
                np.asarray(getattr(asset.parsed, puts[param]), np.float64)[joints],
                operation,
                0.0,
                "these have no limit",
            )
            for param, given in ranges.items()
            if given is not None
        ]
        quantities += self._more(entity, joints, names, operation)
        self._draw = Draw(quantities, distribution)
        self._puts = [(puts.get(q.param, q.param), joints[q.ids]) for q in quantities]

    def _more(
        self,
        entity: ResolvedEntity,
        joints: NDArray[np.int64],
        names: list[str],
        operation: Operation,
    ) -> list[Quantity]:
        """Quantities that are no property of a drive."""
        return []

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the properties of these environments."""
        for (name, joints), values in zip(self._puts, self._draw(env, env_ids), strict=True):
            self._put(name, joints, values, env_ids)

    def _put(
        self, name: str, joints: NDArray[np.int64], values: Any, env_ids: EnvIndex | None
    ) -> None:
        self._drives.put(name, values, env_ids, joints)


@register_term("event", name="randomize_actuator_gains")
class RandomizeActuatorGains(_Drives):
    """Gives the drives of joints random gains; `get_joint_drive` says them.

    Isaac Lab's event of the same name.

    Args:
        entity_cfg: The robot or articulation; joint names or control parts pick joints.
        stiffness_range: N m/rad or N/m: [low, high] or {joint regex: [low, high]}.
        damping_range: N m s/rad or N s/m, of the drive.
        operation: ``abs`` replaces the compiled gains, ``scale`` and ``add`` change them.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_actuator_gains, mode: reset, params: {entity_cfg: {uid: ur10}, stiffness_range: [0.8, 1.2], damping_range: [0.8, 1.2], operation: scale}}``
    """  # noqa: E501

    drive_ranges: ClassVar = {"stiffness_range": "stiffness", "damping_range": "damping"}

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        stiffness_range: Ranges | None = None,
        damping_range: Ranges | None = None,
        operation: Operation = "abs",
        distribution: Distribution = "uniform",
    ) -> None:
        super().__init__(
            entity_cfg,
            driven_joints(entity_cfg),
            {"stiffness_range": stiffness_range, "damping_range": damping_range},
            operation,
            distribution,
            self.drive_ranges,
        )


@register_term("event", name="randomize_effort_limits")
class RandomizeEffortLimits(_Drives):
    """Gives the drives of joints random effort limits; `get_joint_drive` says them.

    mjlab's `effort_limits`. The limit bounds spring and damper together.

    Args:
        entity_cfg: The robot or articulation; joint names or control parts pick joints.
        effort_limit_range: N m or N: [low, high] or {joint regex: [low, high]}.
        operation: ``abs`` replaces the compiled limits; ``scale`` and ``add`` change them, and
            need a declared ``max_effort``.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_effort_limits, mode: reset, params: {entity_cfg: {uid: ur10}, effort_limit_range: {'.*': [50.0, 300.0]}}}``
    """  # noqa: E501

    drive_ranges: ClassVar = {"effort_limit_range": "max_effort"}

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        effort_limit_range: Ranges,
        operation: Operation = "abs",
        distribution: Distribution = "uniform",
    ) -> None:
        super().__init__(
            entity_cfg,
            driven_joints(entity_cfg),
            {"effort_limit_range": effort_limit_range},
            operation,
            distribution,
            self.drive_ranges,
        )


@register_term("event", name="randomize_joint_parameters")
class RandomizeJointParameters(_Drives):
    """Gives joints random dry friction, armature, damping and position limits.

    Isaac Lab's event of the same name. `get_joint_drive` and `get_qpos_limits` say the values;
    targets are clamped to the new limits; action spaces keep the compiled ones.

    Args:
        entity_cfg: The robot or articulation; joint names or control parts pick joints.
        friction_range: Dry friction, N m or N: [low, high] or {joint regex: [low, high]}.
        armature_range: Reflected inertia, kg m^2 or kg.
        damping_range: Passive damping of the joint itself, beside that of a drive, N m s/rad or
            N s/m.
        lower_limit_range: Lower position limits, rad or m, of joints that have limits.
        upper_limit_range: Upper position limits.
        operation: ``abs`` replaces the compiled values, ``scale`` and ``add`` change them.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_joint_parameters, mode: reset, params: {entity_cfg: {uid: ur10}, friction_range: [0.0, 2.0], armature_range: [0.0, 0.1]}}``
    """  # noqa: E501

    drive_ranges: ClassVar = {"armature_range": "armature"}

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        friction_range: Ranges | None = None,
        armature_range: Ranges | None = None,
        damping_range: Ranges | None = None,
        lower_limit_range: Ranges | None = None,
        upper_limit_range: Ranges | None = None,
        operation: Operation = "abs",
        distribution: Distribution = "uniform",
    ) -> None:
        self._limits = {
            param: given
            for param, given in zip(_SIDES, (lower_limit_range, upper_limit_range), strict=True)
            if given is not None
        }
        super().__init__(
            entity_cfg,
            np.asarray(articulation_of(entity_cfg).joint_ids, np.int64),
            {
                "friction_range": friction_range,
                "armature_range": armature_range,
                "damping_range": damping_range,
            },
            operation,
            distribution,
            {
                "friction_range": "friction",
                "armature_range": "armature",
                "damping_range": "joint_damping",
            },
        )

    def _more(
        self,
        entity: ResolvedEntity,
        joints: NDArray[np.int64],
        names: list[str],
        operation: Operation,
    ) -> list[Quantity]:
        compiled = np.asarray(entity.asset.parsed.qpos_limits, np.float64)[joints]
        reach = compiled.copy(), compiled.copy()  # the least and the most of each limit
        found = []
        for param, given in self._limits.items():
            side = _SIDES.index(param)
            default = np.where(np.isfinite(compiled[:, side]), compiled[:, side], 0.0)
            quantity = Quantity(param, given, names, default, operation)
            endless = [names[i] for i in quantity.ids if not np.isfinite(compiled[i]).all()]
            if endless:
                message = f"these joints have no limits: {', '.join(endless)}"
                raise ConfigError([Problem(param, message)])
            reach[0][quantity.ids, side] = np.minimum(quantity.low, quantity.high)
            reach[1][quantity.ids, side] = np.maximum(quantity.low, quantity.high)
            found.append(quantity)
        crossed = [names[i] for i in np.flatnonzero(reach[1][:, 0] >= reach[0][:, 1])]
        if found and crossed:
            message = f"a lower limit may exceed the upper one: {', '.join(crossed)}"
            raise ConfigError([Problem(found[0].param, message)])
        return found

    def _put(
        self, name: str, joints: NDArray[np.int64], values: Any, env_ids: EnvIndex | None
    ) -> None:
        if name in _SIDES:
            self._drives.put_limit(_SIDES.index(name), values, env_ids, joints)
        else:
            self._drives.put(name, values, env_ids, joints)


_SIDES = ("lower_limit_range", "upper_limit_range")
