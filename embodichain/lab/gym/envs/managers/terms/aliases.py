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
    steps = shape if isinstance(shape, list) else [] if shape is None else [shape]
    pairs = [(s, None) if isinstance(s, str) else next(iter(s.items())) for s in steps]
    values = {config_word(name): value for name, value in params.items()}
    return Alias(target, tuple(pairs), values, only, example)


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
        hints = {n: self.parts[i].hints()[key] for n, (i, key) in self.exposed.items()}
        return {**hints, **self.narrower}

    def meaning(
        self, values: Mapping[str, Any], env: TermContext | None = None
    ) -> list[tuple[TermSpec, dict[str, Any]]]:
        """The target and its parameters, then each shape and its parameters.

        Args:
            values: Parameters of the alias.
            env: The environment, for `makers`.
        """
        given = [dict(fixed) for fixed in self.fixed]
        for name, (part, key) in self.exposed.items():
            default = self.params[name].default
            if name in values:
                given[part][key] = values[name]
            elif default is not _EMPTY:
                given[part][key] = default
        shaped = 1 + len(self.steps)
        for (key, maker), own in zip(self.makers.items(), given[shaped:], strict=True):
            given[0][key] = maker.func(env, **maker.arguments(own))
        return list(zip((self.target, *self.steps), given[:shaped], strict=True))


def register_aliases(table: Mapping[str, Alias], *kinds: Kind) -> None:
    """Register names as terms.

    Args:
        table: Name -> its meaning.
        *kinds: The managers that may use it; by default those that the last shape allows: reward
            and metric, and termination if it returns bool.
    """
    TERMS["reward"]  # targets are registered first
    for name, meant in table.items():
        last = meant.shapes[-1][0] if meant.shapes else ""
        for kind in kinds or (VALUE_KINDS[1:] if last in _TRUTHS else ("reward", "metric")):
            add_term(_spec(name, kind, meant))


def _spec(name: str, kind: Kind, meant: Alias) -> AliasSpec:
    tables = [TERMS.registered[k] for k in (kind, *VALUE_KINDS)]
    target = next(table[meant.target] for table in tables if meant.target in table)
    steps = tuple(SHAPES[shape] for shape, _ in meant.shapes)
    functions = {key: value for key, value in meant.params.items() if callable(value)}
    makers = {key: describe_term("shape", function) for key, function in functions.items()}
    parts = (target, *steps, *makers.values())
    kept = target.params if meant.only is None else meant.only
    usual = {key: P(key) for key in target.params if key in kept}
    given = [
        {
            k: meant.params.get(k, usual.get(k))
            for k in target.params
            if k not in makers and (k in meant.params or k in usual)
        },
        *(_of_shape(step, one) for step, (_, one) in zip(steps, meant.shapes, strict=True)),
        *({key: P(key) for key in maker.params} for maker in makers.values()),
    ]
    exposed: dict[str, tuple[int, str]] = {}
    params: dict[str, inspect.Parameter] = {}
    narrower: dict[str, Any] = {}
    texts: dict[str, str] = {}
    for part in (*range(1, len(parts)), 0):
        for key, value in given[part].items():
            if isinstance(value, P):
                source = parts[part].params[key]
                default = source.default if value.default is _EMPTY else value.default
                exposed[value.name] = part, key
                params[value.name] = source.replace(default=_EMPTY if value.needed else default)
                if value.hint is not None:
                    narrower[value.name] = value.hint
                if value.text:
                    texts[value.name] = value.text
    needed = [n for n, p in params.items() if p.default is _EMPTY]
    words = set(REFERENCE_WORDS.values())
    entities = [name for name in needed if words & {name, exposed[name][1]}]
    order = dict.fromkeys([*entities, *needed, *params])
    fixed = tuple({k: v for k, v in one.items() if not isinstance(v, P)} for one in given)
    return AliasSpec(
        name=name,
        kind=kind,
        func=target.func,
        params={n: params[n] for n in order},
        doc=_doc(meant, target),
        lead=target.lead,
        target=target,
        steps=steps,
        makers=makers,
        fixed=fixed,
        exposed=exposed,
        narrower=narrower,
        texts=texts,
        example=meant.example,
    )


def _of_shape(shape: TermSpec, given: Any) -> dict[str, Any]:
    """Parameters of a shape, as given in an alias."""
    if given is None:
        return {}
    if isinstance(given, P) and given.name == "*":
        return {key: P(key) for key in shape.params}
    return dict(given) if isinstance(given, Mapping) else {next(iter(shape.params)): given}


def _doc(meant: Alias, target: TermSpec) -> str:
    """Describe the meaning of a name."""
    shapes = ", ".join(_written(name, given) for name, given in meant.shapes)
    shape = f", shape: {f'[{shapes}]' if len(meant.shapes) > 1 else shapes}" if shapes else ""
    shown = {
        k: v.default if isinstance(v, P) and v.name == k else v for k, v in meant.params.items()
    }
    shown = {k: v for k, v in shown.items() if v not in (_EMPTY, target.params[k].default)}
    values = ", ".join(f"{k}: {_yaml(v)}" for k, v in shown.items())
    params = f", params: {{{values}}}" if values else ""
    return f"Alias of ``{{func: {target.name}{shape}{params}}}``."


def _written(name: str, given: Any) -> str:
    if given is None:
        return name
    if isinstance(given, P) and given.name == "*":
        return f"{{{name}: ...}}"
    return f"{{{name}: {_yaml(given)}}}"


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
