"""The event that randomizes model fields: masses, frictions, gains, sizes, gravity.

An operation is applied to the bounds, so that the drawn number is the value; with equal bounds of 1
(``scale``) or 0 (``add``) the value is exactly the compiled one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import SceneEntityCfg
from embodichain.lab.gym.envs.managers.param_types import Box3, Positive, Ranges, ScaleRange
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.terms.physics_draws import PhysicsDraw, Quantity
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._friction_effect import check_friction_acts
from embodichain.lab.gym.envs.mdp._model_fields import (
    FIELDS,
    SCENE_FIELDS,
    Operation,
    Options,
    Values,
    Write,
)
from embodichain.lab.sim.compiler.names import match_every
from embodichain.utils.arrays import contiguous
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.random import constant

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = ["Randomize"]

Distribution = Literal["uniform", "log_uniform", "gaussian"]
"""Over [low, high]: uniform; uniform in the logarithm; normal with its mean in the middle and the
bounds at three standard deviations, clipped there."""


def _declared_draws(
    entity_cfg: SceneEntityCfg | None,
    entity_cfgs: list[SceneEntityCfg] | None,
    mass: Any,
    com: Any,
    stiffness: Any,
    damping: Any,
    effort_limit: Any,
    armature: Any,
    strength: Any,
    operation: Operation | None,
) -> Iterator[PhysicsDraw]:
    """Yield the parameters that may make drives chatter, or that move centres of mass."""
    entities = list(entity_cfgs or [])
    if entity_cfg is not None:
        entities.insert(0, entity_cfg)
    ranges: dict[Quantity, Any] = {
        "stiffness": stiffness,
        "damping": damping,
        "max_effort": effort_limit,
        "armature": armature,
        "strength": strength,
        "mass": mass,
    }
    for entity in entities:
        for quantity, bounds in ranges.items():
            if bounds is not None:
                yield PhysicsDraw(entity, quantity, bounds, operation or "abs")
        if com is not None:
            yield PhysicsDraw(entity, "com")


@register_term("event", name="randomize", draws=_declared_draws, takes_strength=True)
class Randomize:
    """Draws model fields of an entity, or of the scene, separately in each environment.

    Every draw starts from the compiled values, so repeated calls do not drift. A range is
    [low, high] for all bodies or joints, or {name regex: [low, high]}; only fields with a range
    change. MuJoCo's derived constants are recomputed once a reset.

    Args:
        entity_cfg: The robot, articulation or rigid object; joint names or control parts pick
            joints, link names pick links, else all. Without it the scene: gravity, and the
            friction of the ground, which needs ``scene: {ground: {friction: ...}}``.
        entity_cfgs: Several entities instead, each with its own draws.
        scale: Factors of the size of a box, sphere, ellipsoid, cylinder or capsule: [low, high],
            or [[x, y, z] low, [x, y, z] high]. Mass and inertia follow; `get_body_scale` returns
            the scale. The pose does not change: place a larger object higher. Meshes and planes,
            whose size environments share, are refused.
        mass: kg, of an object or of each link; links without mass are left out.
        com: [[x, y, z] low, [x, y, z] high] in metres, in the body's frame, added to the compiled
            centre of mass. Inertias about the centre of mass do not change.
        inertia: Factors, positive, of the three principal moments together, for the mass at that
            time.
        friction: Sliding coefficient of each object or link that collides. A contact takes that of
            the geom with the higher priority, or the larger one. Ground, table, terrain and static
            objects that were given no friction have the lower priority. A friction that cannot
            act is refused.
        torsional_friction: Torsional coefficient, m; acts where a contact's ``condim`` is 4 or 6.
        rolling_friction: Rolling coefficient, m; acts where a contact's ``condim`` is 6.
        stiffness: Gains of drives, N m/rad or N/m.
        damping: Gains of drives, N m s/rad or N s/m.
        effort_limit: Of drives, N m or N; bounds spring and damper together. ``scale`` and
            ``add`` need a declared ``max_effort``.
        joint_friction: Dry friction of joints, N m or N.
        armature: Reflected inertia of joints, kg m^2 or kg.
        joint_damping: Passive damping of joints, in addition to drives, N m s/rad or N s/m.
        lower_limit: Position limits of joints that have limits, rad or m; targets are clamped to
            them, action spaces keep the compiled ones.
        upper_limit: Likewise.
        strength: Factors, not negative, of the force of drives and of an MJCF file's own actuators
            on the joints: gain, bias and force limit together. `get_joint_drive` keeps the nominal
            gains.
        gravity: [[x, y, z] low, [x, y, z] high], m/s^2; of the scene.
        operation: ``abs`` replaces the compiled value, ``scale`` multiplies it, ``add`` adds to it;
            None is ``abs``, and ``add`` for gravity. `com` always adds, `scale`, `inertia` and
            `strength` always multiply.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.
        recompute_inertia: Whether inertias (and an object's damping) follow a mass.
        min_mass: The smallest mass, kg: smaller draws are raised to it.
        same_scale_all_axes: Whether one factor scales all axes; False draws one per axis (round
            shapes stay round).
        fixed_density: Whether the mass follows the volume of a scaled object; False keeps the
            compiled mass and changes the inertia only.
        shared_sample: Whether all of `entity_cfgs` are scaled by the same draw.

    Raises:
        ConfigError: If the entity has no such field, or the range allows impossible values.

    Example:
        ``{func: randomize, mode: reset, params: {of: {uid: cube}, mass: [0.5, 2.0], friction: [0.3, 1.2]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity | None = None,
        entity_cfgs: list[ResolvedEntity] | None = None,
        scale: ScaleRange | None = None,
        mass: Ranges | None = None,
        com: Box3 | None = None,
        inertia: Ranges | None = None,
        friction: Ranges | None = None,
        torsional_friction: Ranges | None = None,
        rolling_friction: Ranges | None = None,
        stiffness: Ranges | None = None,
        damping: Ranges | None = None,
        effort_limit: Ranges | None = None,
        joint_friction: Ranges | None = None,
        armature: Ranges | None = None,
        joint_damping: Ranges | None = None,
        lower_limit: Ranges | None = None,
        upper_limit: Ranges | None = None,
        strength: Ranges | None = None,
        gravity: Box3 | None = None,
        operation: Operation | None = None,
        distribution: Distribution = "uniform",
        recompute_inertia: bool = True,
        min_mass: Positive = 1e-6,
        same_scale_all_axes: bool = True,
        fixed_density: bool = True,
        shared_sample: bool = False,
    ) -> None:
        # In the order in which they are drawn and written.
        ranges: dict[str, Any] = {
            "scale": scale,
            "mass": mass,
            "com": com,
            "inertia": inertia,
            "friction": friction,
            "torsional_friction": torsional_friction,
            "rolling_friction": rolling_friction,
            "stiffness": stiffness,
            "damping": damping,
            "effort_limit": effort_limit,
            "joint_friction": joint_friction,
            "armature": armature,
            "joint_damping": joint_damping,
            "lower_limit": lower_limit,
            "upper_limit": upper_limit,
            "strength": strength,
            "gravity": gravity,
        }
        self._ranges = {name: bounds for name, bounds in ranges.items() if bounds is not None}
        self._operation = operation
        self._options = Options(
            recompute_inertia=recompute_inertia,
            min_mass=min_mass,
            same_scale_all_axes=same_scale_all_axes,
            fixed_density=fixed_density,
        )
        if entity_cfgs is not None and not entity_cfgs:
            raise ConfigError([Problem("entity_cfgs", "names no object")])
        if scale is not None and same_scale_all_axes and np.shape(scale) == (2, 3):
            message = "a range for every axis needs same_scale_all_axes: false"
            raise ConfigError([Problem("scale", message)])
        if shared_sample and set(self._ranges) - {"scale"}:
            raise ConfigError([Problem("shared_sample", "only objects' scales may be shared")])

        # Name in the log -> what is drawn; for each of them the functions that write it.
        self._drawn_fields: dict[str, DrawnField] = {}
        self._writes: list[list[Write]] = []
        entities = list(entity_cfgs or [])
        if entity_cfg is not None:
            entities.insert(0, entity_cfg)
        if not entities:
            self._add_scene(env)
        elif shared_sample:
            self._add_entities(env, entities, prefix="")
        else:
            for entity in entities:
                prefix = f"{entity.uid}." if len(entities) > 1 else ""
                self._add_entities(env, [entity], prefix)
        self._draw = FieldDraw(self._drawn_fields, distribution)

    def _add_scene(self, env: TermContext) -> None:
        """Add the fields of the scene."""
        for name in self._ranges:
            if name not in SCENE_FIELDS:
                message = f"missing: of which entity is {name!r} randomized?"
                raise ConfigError([Problem("entity_cfg", message)])
            read_values, default_operation = SCENE_FIELDS[name]
            operation = self._operation or default_operation
            self._add_field(env, name, name, [read_values(env.sim.engine)], operation)

    def _add_entities(
        self, env: TermContext, entities: Sequence[ResolvedEntity], prefix: str
    ) -> None:
        """Add the fields of entities that share each draw."""
        for name in self._ranges:
            field = FIELDS.get(name)
            if field is None:
                message = f"{name} belongs to the scene: leave `of` out"
                raise ConfigError([Problem(name, message)])
            if field.fixed and self._operation not in (None, field.operation):
                message = f"{name} is always of operation {field.operation!r}"
                raise ConfigError([Problem("operation", message)])
            values = [field.values(entity, self._options) for entity in entities]
            operation = self._operation or field.operation
            self._add_field(env, prefix + name, name, values, operation)
        _check_limits(
            entities[0],
            lower=self._drawn_fields.get(f"{prefix}lower_limit"),
            upper=self._drawn_fields.get(f"{prefix}upper_limit"),
        )

    def _add_field(
        self,
        env: TermContext,
        label: str,
        param: str,
        values_of_entities: Sequence[Values],
        operation: Operation,
    ) -> None:
        """Add a field that is drawn once and written to each of the entities."""
        ranges = self._ranges[param]
        drawn = DrawnField(param, ranges, operation, values_of_entities[0])
        for values in values_of_entities:
            if len(values.geoms):
                check_friction_acts(
                    env,
                    param,
                    names=[values.names[i] for i in drawn.ids],
                    geoms=[values.geoms[i] for i in drawn.ids],
                    axis=values.axis,
                    highest=np.maximum(drawn.low, drawn.high),
                    each=isinstance(ranges, Mapping),
                )
        self._drawn_fields[label] = drawn
        self._writes.append([values.write(drawn.ids) for values in values_of_entities])

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the fields of these environments."""
        for writes, values in zip(self._writes, self._draw(env, env_ids), strict=True):
            for write in writes:
                write(values, env_ids)


def _check_limits(
    entity: ResolvedEntity, lower: DrawnField | None, upper: DrawnField | None
) -> None:
    """Refuse ranges in which a lower position limit may exceed the upper one.

    Args:
        entity: The articulation.
        lower: The drawn lower limits, if they are drawn.
        upper: The drawn upper limits, likewise.
    """
    first_drawn = lower or upper
    if first_drawn is None:
        return
    parsed = entity.articulation.parsed
    joints = np.asarray(entity.joint_ids, np.int64)
    highest_lower, lowest_upper = np.asarray(parsed.qpos_limits, np.float64)[joints].T.copy()
    if lower is not None:
        highest_lower[lower.ids] = np.maximum(lower.low, lower.high)
    if upper is not None:
        lowest_upper[upper.ids] = np.minimum(upper.low, upper.high)
    crossed = np.flatnonzero(highest_lower >= lowest_upper)
    if len(crossed):
        names = ", ".join(parsed.joint_names[joints[i]] for i in crossed)
        message = f"a lower limit may exceed the upper one: {names}"
        raise ConfigError([Problem(first_drawn.param, message)])


class DrawnField:
    """The ranges of the drawn values of one field of an entity.

    Args:
        param: The parameter that gives the range, for messages.
        ranges: [low, high], {name regex: [low, high]}, or [[low, ...], [high, ...]] with a column
            for every value, or for each of a group of values that repeats.
        operation: See `Operation`.
        values: The values of the field.

    Attributes:
        ids: (m,) indices of the drawn values.
        low, high: (m,) bounds of the value.
        factors: (m,) bounds of the number drawn, low and high.

    Raises:
        ConfigError: If a key matches nothing, or the range allows impossible values.
    """

    def __init__(self, param: str, ranges: Any, operation: Operation, values: Values) -> None:
        self.param = param
        self.operation = operation
        low, high = _read_ranges(param, ranges, values.names)
        self.ids: NDArray[np.int64] = np.flatnonzero(~np.isnan(low))
        self.factors = (low[self.ids], high[self.ids])
        self.default: Floats = np.array(values.default, np.float64)[self.ids]
        if operation != "abs" or values.needs_default:
            self._check_defaults(values)
        self.low = constant(self.apply(self.factors[0]))
        self.high = constant(self.apply(self.factors[1]))
        if values.lowest is not None:
            self._check_lowest(values, values.lowest)

    def _check_defaults(self, values: Values) -> None:
        """Refuse drawn values whose compiled ones are infinite."""
        unlimited = [values.names[int(i)] for i in self.ids if not np.isfinite(values.default[i])]
        if not unlimited:
            return
        message = f"{values.unlimited}: {', '.join(unlimited)}"
        if not values.needs_default:
            message += "; use operation: abs"
        raise ConfigError([Problem(self.param, message)])

    def _check_lowest(self, values: Values, lowest: float) -> None:
        """Refuse a range that allows values that are too small."""
        smallest = np.minimum(self.low, self.high)
        if (smallest < lowest).any():
            worst = int(np.argmin(smallest))
            name = values.names[int(self.ids[worst])]
            message = f"would give {name} {smallest[worst]:g}, below {lowest:g}"
            raise ConfigError([Problem(self.param, message)])

    def apply(self, drawn: Floats) -> Floats:
        """Values (..., m) of drawn numbers (..., m)."""
        if self.operation == "add":
            return self.default + drawn
        if self.operation == "scale":
            return self.default * drawn
        return drawn

    def weaken(self, values: Floats, strength: float) -> Floats:
        """Values (..., m) nearer to the compiled ones, as `EventCfg.strength` says.

        Raises:
            ConfigError: If there is nothing to be nearer to: no finite compiled value, or a factor
                below 0.
        """
        if not np.isfinite(self.default).all():
            message = "strength needs a compiled value, and there is no limit; use strength: 1"
            raise ConfigError([Problem(self.param, message)])
        if self.operation != "scale":
            return self.default + strength * (values - self.default)
        if min(self.factors[0].min(initial=0.0), self.factors[1].min(initial=0.0)) < 0.0:
            message = "strength needs factors that are not negative"
            raise ConfigError([Problem(self.param, message)])
        nonzero_default = np.where(self.default == 0.0, 1.0, self.default)  # 0 stays 0
        return self.default * (values / nonzero_default) ** strength


def _read_ranges(param: str, ranges: Any, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Lower and upper bounds (k,) each; NaN for names that no key matches. Later keys win."""
    low = np.full(len(names), np.nan)
    high = np.full(len(names), np.nan)
    if not isinstance(ranges, Mapping):
        bounds = np.asarray(ranges, np.float64).reshape(2, -1)
        low[:], high[:] = np.tile(bounds, (1, len(names) // bounds.shape[1]))
        return low, high
    if not ranges:
        raise ConfigError([Problem(param, f"names nothing; there are: {', '.join(names)}")])
    for pattern, (lower, upper) in ranges.items():
        matching, problems = match_every(pattern, names, "name", f"{param}.{pattern}")
        if problems:
            raise ConfigError(problems)
        low[list(matching)] = lower
        high[list(matching)] = upper
    return low, high


class FieldDraw:
    """Draws all fields of one term in one call: a call takes as long as 1000 of its numbers.

    Args:
        fields: Name in the log -> field.
        distribution: See `Distribution`.

    Raises:
        ConfigError: If there is nothing to draw, or a bound of ``log_uniform`` is not positive.
    """

    def __init__(self, fields: Mapping[str, DrawnField], distribution: Distribution) -> None:
        if not fields:
            raise ConfigError([Problem("", "randomizes nothing: give it at least one range")])
        self._names = list(fields)
        self._fields = list(fields.values())
        self._is_normal = distribution == "gaussian"
        self._is_log = distribution == "log_uniform"
        # Logarithms are logged as they are drawn: `strength` acts on the values, which are logged
        # too if it does.
        self._weaken = {} if self._is_log else {name: f.weaken for name, f in fields.items()}
        # The columns of each field in what is drawn.
        self._columns: dict[str, slice] = {}
        start = 0
        for name, field in fields.items():
            end = start + len(field.ids)
            self._columns[f"log_{name}" if self._is_log else name] = slice(start, end)
            start = end
        if not self._is_log:
            self._low = constant(np.concatenate([field.low for field in self._fields]))
            self._high = constant(np.concatenate([field.high for field in self._fields]))
            return
        for field in self._fields:
            lowest = field.factors[0].min(initial=np.inf)
            if lowest <= 0:
                message = f"log_uniform needs positive bounds, got {lowest:g}"
                raise ConfigError([Problem(field.param, message)])
        self._lowest_factor = np.concatenate([field.factors[0] for field in self._fields])
        self._highest_factor = np.concatenate([field.factors[1] for field in self._fields])
        self._low = constant(np.log(self._lowest_factor))
        self._high = constant(np.log(self._highest_factor))

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> list[Floats]:
        """Values (n, m) of every field; do not write into them."""
        draws = env.event_manager
        drawn = draws.draw_columns(
            self._columns, self._low, self._high, env_ids, self._is_normal, self._weaken
        )
        slices = self._columns.values()
        if not self._is_log:
            return [drawn[:, columns] for columns in slices]
        # Rounding of log and exp must not leave the range.
        factors = np.clip(np.exp(contiguous(drawn)), self._lowest_factor, self._highest_factor)
        pairs = zip(self._fields, slices, strict=True)
        values = [field.apply(factors[:, columns]) for field, columns in pairs]
        if draws.strength == 1.0:
            return values
        weakened: list[Floats] = []
        for name, field, value in zip(self._names, self._fields, values, strict=True):
            result = field.weaken(value, draws.strength)
            draws.log_draw(name, result)
            weakened.append(result)
        return weakened
