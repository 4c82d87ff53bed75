"""Random values of named things - links, joints, axes - that begin at what was compiled.

What every randomizer of model fields shares: ranges by name, the operation, the distribution, and
one draw for all quantities of a term. Which field a value goes to is each term's business.

The operation is folded into the bounds, so that what is drawn is the value itself; equal bounds
then give exactly the compiled value times one, or plus nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Ranges
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = [
    "Distribution",
    "Draw",
    "Operation",
    "Quantity",
    "Ranges",
    "articulation_of",
    "bodies_of",
    "driven_joints",
    "object_of",
]

Operation = Literal["add", "scale", "abs"]
"""What a drawn number does to the compiled one: is added, multiplies it, or replaces it."""
Distribution = Literal["uniform", "log_uniform", "gaussian"]
"""Over [low, high]: uniform; uniform in the logarithm; normal with its mean in the middle and the
bounds at three standard deviations, clipped there."""


class Quantity:
    """One property of k named things, and what it is drawn from.

    Args:
        param: The parameter that gives the range: for messages, and the name in the log without
            ``_range``.
        ranges: [low, high], {name regex: [low, high]}, or [[low, ...], [high, ...]] with a column
            for every thing.
        names: What the things are called.
        default: (k,) compiled values.
        operation: See `Operation`.
        lowest: The least value that makes sense; None is any.
        finite: Why a default may be infinite: said where the operation needs a finite one.

    Attributes:
        ids: (m,) which of the things are drawn.
        low, high: (m,) bounds of the value.

    Raises:
        ConfigError: If a key matches nothing, or values below `lowest` would be drawn.
    """

    def __init__(
        self,
        param: str,
        ranges: Ranges | Sequence[Sequence[float]],
        names: Sequence[str],
        default: F64,
        operation: Operation,
        lowest: float | None = None,
        finite: str = "",
    ) -> None:
        self.param, self.operation = param, operation
        self.name = param.removesuffix("_range")
        low, high = _by_name(param, ranges, names)
        self.ids: NDArray[np.int64] = np.flatnonzero(~np.isnan(low))
        self.factors = low[self.ids], high[self.ids]
        self.default: F64 = np.array(default, np.float64)[self.ids]
        if operation != "abs" and not np.isfinite(self.default).all():
            wrong = [names[int(i)] for i in self.ids if not np.isfinite(default[i])]
            message = f"{finite}: {', '.join(wrong)}; use operation: abs"
            raise ConfigError([Problem(param, message)])
        ends = [self.apply(f) for f in self.factors]
        self.low, self.high = constant(ends[0]), constant(ends[1])
        least = np.minimum(self.low, self.high)
        if lowest is not None and (least < lowest).any():
            worst = int(np.argmin(least))
            message = f"would give {names[int(self.ids[worst])]} {least[worst]:g}, below {lowest:g}"
            raise ConfigError([Problem(param, message)])

    def apply(self, drawn: F64) -> F64:
        """Values (..., m) of drawn numbers (..., m)."""
        if self.operation == "add":
            return self.default + drawn
        return self.default * drawn if self.operation == "scale" else drawn


def _by_name(
    param: str, ranges: Ranges | Sequence[Sequence[float]], names: Sequence[str]
) -> tuple[F64, F64]:
    """Lower and upper bounds (k,) each; NaN for what no key names. Later keys win."""
    low, high = np.full(len(names), np.nan), np.full(len(names), np.nan)
    if not isinstance(ranges, Mapping):
        low[:], high[:] = ranges
        return low, high
    for pattern, (least, most) in ranges.items():
        try:
            found = [i for i, name in enumerate(names) if re.fullmatch(pattern, name)]
        except re.error as error:
            raise ConfigError([Problem(f"{param}.{pattern}", f"malformed: {error}")]) from error
        if not found:
            message = f"matches none of: {', '.join(names)}"
            hint = did_you_mean(pattern, names).strip()
            raise ConfigError([Problem(f"{param}.{pattern}", message, hint)])
        low[found], high[found] = least, most
    if not ranges:
        raise ConfigError([Problem(param, f"names nothing; there are: {', '.join(names)}")])
    return low, high


class Draw:
    """Draws the quantities of one term together: one draw costs as much as a thousand numbers.

    Args:
        quantities: What is drawn.
        distribution: See `Distribution`.

    Raises:
        ConfigError: If there is nothing to draw, or a logarithm is asked of what is not positive.
    """

    def __init__(self, quantities: Sequence[Quantity], distribution: Distribution) -> None:
        self.quantities = list(quantities)
        if not quantities:
            raise ConfigError([Problem("", "randomizes nothing: give it at least one range")])
        self._normal = distribution == "gaussian"
        self._log = distribution == "log_uniform"
        edges = np.cumsum([0, *(len(q.ids) for q in quantities)]).tolist()
        self._slices = [slice(a, b) for a, b in zip(edges, edges[1:], strict=False)]
        prefix = "log_" if self._log else ""
        self._columns = {
            prefix + q.name: where for q, where in zip(quantities, self._slices, strict=True)
        }
        if not self._log:
            self._low = constant(np.concatenate([q.low for q in quantities]))
            self._high = constant(np.concatenate([q.high for q in quantities]))
            return
        for q in quantities:
            if (q.factors[0] <= 0).any():
                message = f"log_uniform needs positive bounds, got {q.factors[0].min():g}"
                raise ConfigError([Problem(q.param, message)])
        self._bounds = [np.concatenate([q.factors[i] for q in quantities]) for i in (0, 1)]
        self._low, self._high = (constant(np.log(bound)) for bound in self._bounds)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> list[F64]:
        """Values (n, m) of every quantity; do not write into them."""
        manager = env.event_manager
        drawn = manager.draw_columns(self._columns, self._low, self._high, env_ids, self._normal)
        if not self._log:
            return [drawn[:, where] for where in self._slices]
        # Rounding of log and exp must not leave the range.
        factors = np.clip(np.exp(np.ascontiguousarray(drawn)), *self._bounds)
        pairs = zip(self.quantities, self._slices, strict=True)
        return [quantity.apply(factors[:, where]) for quantity, where in pairs]


def object_of(entity: ResolvedEntity, dynamic: str = "") -> ResolvedEntity:
    """The entity, if it is a rigid object.

    Args:
        entity: What the config names.
        dynamic: What it must be dynamic for; empty if it need not.

    Raises:
        ConfigError: If it is not.
    """
    if not hasattr(entity.asset, "is_non_dynamic"):
        message = f"{entity.uid!r} is no rigid object but has joints and links"
        raise ConfigError([Problem("entity_cfg.uid", message)])
    if dynamic and entity.asset.is_non_dynamic:
        kind = entity.asset.cfg.body_type
        message = f"{entity.uid!r} is {kind}: {dynamic} means nothing unless body_type: dynamic"
        raise ConfigError([Problem("entity_cfg.uid", message)])
    return entity


def articulation_of(entity: ResolvedEntity) -> ResolvedEntity:
    """The entity, if it has joints.

    Raises:
        ConfigError: If it has none.
    """
    if not hasattr(entity.asset, "parsed"):
        raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} has no joints")])
    return entity


def bodies_of(entity: ResolvedEntity) -> tuple[list[str], NDArray[np.int64]]:
    """Names and MuJoCo body ids of the picked links; all of them without a choice."""
    asset = entity.asset
    if not hasattr(asset, "parsed"):
        return [entity.uid], np.array([asset.entity.root_body_id], np.int64)
    names = list(entity.link_names or asset.parsed.link_names)
    return names, np.array([asset.body_of(name) for name in names], np.int64)


def driven_joints(entity: ResolvedEntity) -> NDArray[np.int64]:
    """Indices of the picked joints, which all have a drive.

    Raises:
        ConfigError: If one has none; lists those.
    """
    asset = articulation_of(entity).asset
    joints = np.asarray(entity.joint_ids, np.int64)
    wrong = joints[np.asarray(asset.entity.actuator_ids, np.int64)[joints] < 0]
    if len(wrong) or not len(joints):
        names = ", ".join(asset.parsed.joint_names[i] for i in wrong) or "(no joint)"
        message = f"joints of {entity.uid!r} without a drive: {names}"
        hint = "for motors and the like of an MJCF file use randomize_actuator_strength"
        raise ConfigError([Problem("entity_cfg", message, hint)])
    return joints
