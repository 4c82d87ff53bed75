"""Other names of terms: `alias` describes one, `register_aliases` adds a table of them.

``"joint_vel_l2": alias("joint_velocity", "l2")`` makes ``{func: joint_vel_l2}`` mean ``{func:
joint_velocity, shape: l2}``. A parameter of the target may have a fixed value, another name (`P`),
or a value that a function computes from its own parameters.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.managers.terms.registry import (
    SHAPES,
    TERMS,
    VALUE_KINDS,
    Kind,
    TermSpec,
    add_term,
    config_word,
    describe_term,
)
from embodichain.lab.sim.configs.references import REFERENCE_WORDS

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext

__all__ = ["Alias", "AliasSpec", "P", "alias", "register_aliases"]

_EMPTY = inspect.Parameter.empty
_TRUTHS = ("above", "below", "within", "outside")


@dataclass(frozen=True)
class P:
    """A parameter of an alias.

    Attributes:
        name: Its name in the alias; ``*`` is all parameters of a shape.
        default: Its default value; absent is the target's default.
        hint: Its type, if it is narrower than the target's.
        needed: Whether a config must set it although the target has a default.
        text: Its description, if it differs from the target's.
    """

    name: str
    default: Any = _EMPTY
    hint: Any = None
    needed: bool = False
    text: str = ""


@dataclass(frozen=True)
class Alias:
    """The target, shapes and parameters of an alias; see `alias`."""

    target: str
    shapes: tuple[tuple[str, Any], ...]
    params: Mapping[str, Any]
    only: Sequence[str] | None
    example: str


def alias(
    target: str,
    shape: Any = None,
    /,
    *,
    only: Sequence[str] | None = None,
    example: str = "",
    **params: Any,
) -> Alias:
    """Describe another name of a term, or of a quantity with a shape.

    Args:
        target: The term's or the quantity's name.
        shape: As in a config: ``l2``, ``{tanh: P("std")}`` or a list of these.
        only: Parameters of the target that keep their names and defaults; None is all that are not
            in `params`.
        example: Parameters of the alias in its example, as YAML; without it they are taken from
            the examples of the target and of the shapes.
        **params: Parameters of the target (``from_`` for ``from``): a fixed value, a `P`, or a
            function that takes the environment and parameters of the alias and returns the value.
    """
    steps: list[Any] = []
    if isinstance(shape, list):
        steps = shape
    elif shape is not None:
        steps = [shape]
    shapes = tuple((step, None) if isinstance(step, str) else _single_item(step) for step in steps)
    values = {config_word(name): value for name, value in params.items()}
    return Alias(target, shapes, params=values, only=only, example=example)


def _single_item(step: Mapping[str, Any]) -> tuple[str, Any]:
    """Return name and parameters of a shape ``{name: parameters}``."""
    return next(iter(step.items()))


@dataclass(frozen=True)
class AliasSpec(TermSpec):
    """A term that is another name of a term, or of a quantity with shapes.

    Attributes:
        target: The term.
        steps: The shapes, in order.
        makers: Parameter of the target -> the function that makes its value.
        fixed: The values that the alias sets, one map for each of `parts`.
        exposed: Parameter -> index in `parts` and its name there.
        narrower: Parameter -> its type, where it is narrower than the target's.
        texts: Parameter -> its description, where it differs from the target's.
        example: Parameters in its example, as YAML; empty if they follow from those of `parts`.
    """

    target: TermSpec = field(default=None)  # type: ignore[assignment]
    steps: tuple[TermSpec, ...] = ()
    makers: Mapping[str, TermSpec] = field(default_factory=dict)
    fixed: tuple[dict[str, Any], ...] = ()
    exposed: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    narrower: Mapping[str, Any] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    example: str = ""

    @property
    def place(self) -> str:
        """The module and name of the target, and the alias's name, which makes it unique."""
        return f"{self.target.place} as {self.name}"

    @property
    def parts(self) -> tuple[TermSpec, ...]:
        """The owners of the parameters: the target, the shapes, and the functions in `makers`."""
        return (self.target, *self.steps, *self.makers.values())

    @property
    def names(self) -> dict[str, str]:
        """Parameter of the target or of a shape -> the alias's name of it."""
        return {key: name for name, (_, key) in self.exposed.items()}

    def hints(self) -> dict[str, Any]:
        """Types of the parameters, from the target or a shape."""
        parts = self.parts
        hints = {name: parts[part].hints()[key] for name, (part, key) in self.exposed.items()}
        return {**hints, **self.narrower}

    def meaning(
        self, values: Mapping[str, Any], env: TermContext | None = None
    ) -> list[tuple[TermSpec, dict[str, Any]]]:
        """Return the target and its parameters, then each shape and its parameters.

        Args:
            values: Parameters of the alias.
            env: The environment, for `makers`.
        """
        # The parameters of each of `parts`.
        params = [dict(fixed) for fixed in self.fixed]
        for name, (part, key) in self.exposed.items():
            default = self.params[name].default
            if name in values:
                params[part][key] = values[name]
            elif default is not _EMPTY:
                params[part][key] = default
        count = 1 + len(self.steps)
        of_target = params[0]
        of_makers = params[count:]
        for (key, maker), of_maker in zip(self.makers.items(), of_makers, strict=True):
            of_target[key] = maker.func(env, **maker.arguments(of_maker))
        return list(zip((self.target, *self.steps), params[:count], strict=True))


def register_aliases(table: Mapping[str, Alias], *kinds: Kind) -> None:
    """Register names as terms.

    Args:
        table: Name -> its meaning.
        *kinds: The managers that may use it; by default those that the last shape allows: reward
            and metric, and termination if it returns bool.
    """
    TERMS["reward"]  # targets are registered first
    for name, described in table.items():
        last_shape = described.shapes[-1][0] if described.shapes else ""
        allowed: Sequence[Kind] = ("reward", "metric")
        if last_shape in _TRUTHS:
            allowed = VALUE_KINDS[1:]
        for kind in kinds or allowed:
            add_term(_spec(name, kind, described))


def _spec(name: str, kind: Kind, described: Alias) -> AliasSpec:
    """Return the term that an alias describes, of one kind."""
    tables = [TERMS.registered[of_kind] for of_kind in (kind, *VALUE_KINDS)]
    target = next(table[described.target] for table in tables if described.target in table)
    steps = tuple(SHAPES[shape] for shape, _ in described.shapes)
    makers = {
        key: describe_term("shape", value)
        for key, value in described.params.items()
        if callable(value)
    }
    parts = (target, *steps, *makers.values())
    # The values of each part's parameters: fixed ones, and a `P` for each that a config may set.
    values: list[dict[str, Any]] = [_params_of_target(described, target, makers)]
    for step, (_, params) in zip(steps, described.shapes, strict=True):
        values.append(_params_of_shape(step, params))
    for maker in makers.values():
        values.append({key: P(key) for key in maker.params})

    exposed: dict[str, tuple[int, str]] = {}
    params_by_name: dict[str, inspect.Parameter] = {}
    narrower: dict[str, Any] = {}
    texts: dict[str, str] = {}
    # Where two parts expose the same name, it is the target's.
    for part in (*range(1, len(parts)), 0):
        for key, value in values[part].items():
            if not isinstance(value, P):
                continue
            exposed[value.name] = (part, key)
            params_by_name[value.name] = _parameter(parts[part].params[key], value)
            if value.hint is not None:
                narrower[value.name] = value.hint
            if value.text:
                texts[value.name] = value.text
    return AliasSpec(
        name=name,
        kind=kind,
        func=target.func,
        params=_in_order(params_by_name, exposed),
        doc=_doc(described, target),
        lead=target.lead,
        takes_strength=target.takes_strength,
        target=target,
        steps=steps,
        makers=makers,
        fixed=tuple(
            {key: value for key, value in of_part.items() if not isinstance(value, P)}
            for of_part in values
        ),
        exposed=exposed,
        narrower=narrower,
        texts=texts,
        example=described.example,
    )


def _params_of_target(
    described: Alias, target: TermSpec, makers: Mapping[str, TermSpec]
) -> dict[str, Any]:
    """Return the target's parameters, as the alias gives them; without those that are made."""
    passed_on = target.params if described.only is None else described.only
    values: dict[str, Any] = {}
    for key in target.params:
        if key in makers:
            continue
        if key in described.params:
            values[key] = described.params[key]
        elif key in passed_on:
            values[key] = P(key)
    return values


def _parameter(source: inspect.Parameter, value: P) -> inspect.Parameter:
    """Return a parameter of the alias, from that of the target or of a shape."""
    if value.needed:
        return source.replace(default=_EMPTY)
    return source.replace(default=source.default if value.default is _EMPTY else value.default)


def _in_order(
    params: Mapping[str, inspect.Parameter], exposed: Mapping[str, tuple[int, str]]
) -> dict[str, inspect.Parameter]:
    """Return parameters in the order of pages: needed references, other needed ones, the rest."""
    needed = [name for name, parameter in params.items() if parameter.default is _EMPTY]
    words = set(REFERENCE_WORDS.values())
    entities = [name for name in needed if words & {name, exposed[name][1]}]
    return {name: params[name] for name in dict.fromkeys([*entities, *needed, *params])}


def _params_of_shape(shape: TermSpec, params: Any) -> dict[str, Any]:
    """Return the parameters of a shape, as an alias gives them."""
    if params is None:
        return {}
    if isinstance(params, P) and params.name == "*":
        return {key: P(key) for key in shape.params}
    if isinstance(params, Mapping):
        return dict(params)
    return {next(iter(shape.params)): params}


def _doc(described: Alias, target: TermSpec) -> str:
    """Describe the meaning of a name."""
    shapes = [_written(name, params) for name, params in described.shapes]
    listed_shapes = ", ".join(shapes)
    shape = ""
    if len(shapes) > 1:
        shape = f", shape: [{listed_shapes}]"
    elif shapes:
        shape = f", shape: {listed_shapes}"
    shown: dict[str, Any] = {}
    for key, value in described.params.items():
        if isinstance(value, P) and value.name == key:
            value = value.default
        if value not in (_EMPTY, target.params[key].default):
            shown[key] = value
    params = ""
    if shown:
        params = f", params: {{{', '.join(f'{k}: {_yaml(v)}' for k, v in shown.items())}}}"
    return f"Alias of ``{{func: {target.name}{shape}{params}}}``."


def _written(name: str, params: Any) -> str:
    """Return a shape as YAML."""
    if params is None:
        return name
    if isinstance(params, P) and params.name == "*":
        return f"{{{name}: ...}}"
    return f"{{{name}: {_yaml(params)}}}"


def _yaml(value: Any) -> str:
    if isinstance(value, P):
        return value.name.upper()
    if callable(value):
        return "..."
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{k}: {_yaml(v)}' for k, v in value.items())}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_yaml, value))}]"
    return {float("inf"): ".inf", float("-inf"): "-.inf"}.get(value, str(value))
