"""Names for a quantity with a shape: `alias` describes one, `register_aliases` adds a table.

``"joint_vel_l2": alias("joint_velocity", "l2")`` makes ``{func: joint_vel_l2}`` mean ``{func:
joint_velocity, shape: l2}``. A parameter of the alias may be one of the quantity or of a shape
under another name: `P`.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from embodichain.lab.gym.envs.managers.registry import (
    SHAPES,
    TERMS,
    VALUE_KINDS,
    Kind,
    TermSpec,
    add_term,
)

__all__ = ["Alias", "AliasSpec", "P", "alias", "register_aliases"]

_EMPTY = inspect.Parameter.empty
_OLD = {"of": "entity_cfg", "from": "source_entity_cfg", "to": "target_entity_cfg"}
_TRUTHS = ("above", "below", "within", "outside")


@dataclass(frozen=True)
class P:
    """A parameter of an alias.

    Attributes:
        name: What the alias calls it; ``*`` stands for all parameters of a shape.
        default: Its value where a config gives none; without it that of what it stands for.
        hint: Its type, if that is narrower than of what it stands for.
        needed: Whether a config must give it, although what it stands for has a default.
    """

    name: str
    default: Any = _EMPTY
    hint: Any = None
    needed: bool = False


@dataclass(frozen=True)
class Alias:
    """What a name stands for; see `alias`."""

    quantity: str
    shapes: tuple[tuple[str, Any], ...]
    params: Mapping[str, Any]


def alias(quantity: str, shape: Any = None, /, **params: Any) -> Alias:
    """Describe a name for a quantity with a shape.

    Args:
        quantity: The quantity's name.
        shape: As in a config: ``l2``, ``{tanh: P("std")}`` or a list of these.
        **params: Parameters of the quantity (``from_`` for ``from``): a fixed value, or a `P`. The
            others keep their names, but for ``of``, ``from`` and ``to``, which become
            ``entity_cfg``, ``source_entity_cfg`` and ``target_entity_cfg``.
    """
    steps = shape if isinstance(shape, list) else [] if shape is None else [shape]
    pairs = [(s, None) if isinstance(s, str) else next(iter(s.items())) for s in steps]
    return Alias(quantity, tuple(pairs), {k.removesuffix("_"): v for k, v in params.items()})


@dataclass(frozen=True)
class AliasSpec(TermSpec):
    """A term whose name stands for a quantity with shapes.

    Attributes:
        target: The quantity.
        steps: The shapes, in order.
        fixed: The values that the alias sets: of the quantity, then of each shape.
        exposed: Parameter -> which of these (0 is the quantity) and its parameter there.
        narrower: Parameter -> its type, where that is not the type of what it stands for.
    """

    target: TermSpec = field(default=None)  # type: ignore[assignment]
    steps: tuple[TermSpec, ...] = ()
    fixed: tuple[dict[str, Any], ...] = ()
    exposed: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    narrower: Mapping[str, Any] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """Where the quantity is defined, and the name, which tells aliases apart."""
        return f"{self.target.place} as {self.name}"

    def hints(self) -> dict[str, Any]:
        """Types of the parameters: those of what they stand for."""
        parts = (self.target, *self.steps)
        hints = {name: parts[i].hints()[key] for name, (i, key) in self.exposed.items()}
        return {**hints, **self.narrower}

    def meaning(self, values: Mapping[str, Any]) -> list[tuple[TermSpec, dict[str, Any]]]:
        """The quantity and its parameters, then each shape and its own.

        Args:
            values: Parameters of the alias.
        """
        given = [dict(fixed) for fixed in self.fixed]
        for name, (part, key) in self.exposed.items():
            default = self.params[name].default
            if name in values:
                given[part][key] = values[name]
            elif default is not _EMPTY:
                given[part][key] = default
        return list(zip((self.target, *self.steps), given, strict=True))


def register_aliases(table: Mapping[str, Alias], *kinds: Kind) -> None:
    """Register names as terms.

    Args:
        table: Name -> what it stands for.
        *kinds: The managers that may use them; none are those that the last shape allows: reward
            and metric, and termination if it is a truth.
    """
    TERMS["reward"]  # what they stand for is registered first
    for name, meant in table.items():
        last = meant.shapes[-1][0] if meant.shapes else ""
        chosen = kinds or (VALUE_KINDS[1:] if last in _TRUTHS else ("reward", "metric"))
        for kind in chosen:
            add_term(_spec(name, kind, meant))


def _spec(name: str, kind: Kind, meant: Alias) -> AliasSpec:
    target = next(TERMS.registered[k][meant.quantity] for k in (kind, *VALUE_KINDS)
                  if meant.quantity in TERMS.registered[k])  # fmt: skip
    steps = tuple(SHAPES[shape] for shape, _ in meant.shapes)
    fixed: list[dict[str, Any]] = [{} for _ in range(len(steps) + 1)]
    exposed: dict[str, tuple[int, str]] = {}
    params: dict[str, inspect.Parameter] = {}
    narrower: dict[str, Any] = {}

    def add(part: int, key: str, given: P) -> None:
        source = (target, *steps)[part].params[key]
        default = source.default if given.default is _EMPTY else given.default
        default = _EMPTY if given.needed else default
        exposed[given.name] = (part, key)
        if given.hint is not None:
            narrower[given.name] = given.hint
        params[given.name] = source.replace(default=default)

    for part, (_, given) in enumerate(meant.shapes, 1):
        for key, value in _of_shape(steps[part - 1], given).items():
            if isinstance(value, P):
                add(part, key, value)
            else:
                fixed[part][key] = value
    for key in target.params:
        value = meant.params.get(key, P(_OLD.get(key, key)))
        if isinstance(value, P):
            add(0, key, value)
        else:
            fixed[0][key] = value
    entities = [n for n, (part, key) in exposed.items() if part == 0 and key in _OLD]
    needed = [n for n, p in params.items() if p.default is _EMPTY and n not in entities]
    order = dict.fromkeys([*(n for n in entities if params[n].default is _EMPTY), *needed, *params])
    return AliasSpec(
        name=name,
        kind=kind,
        func=target.func,
        params={n: params[n] for n in order},
        doc=_doc(meant, target, fixed),
        lead=target.lead,
        target=target,
        steps=steps,
        fixed=tuple(fixed),
        exposed=exposed,
        narrower=narrower,
    )


def _of_shape(shape: TermSpec, given: Any) -> dict[str, Any]:
    """Parameters of a shape as an alias gives them."""
    if given is None:
        return {}
    if isinstance(given, P) and given.name == "*":
        return {key: P(key) for key in shape.params}
    return dict(given) if isinstance(given, Mapping) else {next(iter(shape.params)): given}


def _doc(meant: Alias, target: TermSpec, fixed: Sequence[Mapping[str, Any]]) -> str:
    """Say what a name stands for."""
    shapes = ", ".join(_written(name, given) for name, given in meant.shapes)
    shape = f", shape: {f'[{shapes}]' if len(meant.shapes) > 1 else shapes}" if shapes else ""
    values = {k: f"{v.name.upper()}" for k, v in meant.params.items() if isinstance(v, P)}
    values |= {k: _yaml(v) for k, v in fixed[0].items() if v != target.params[k].default}
    set_ = ", ".join(f"{k}: {v}" for k, v in values.items())
    params = f", params: {{{set_}}}" if set_ else ""
    return f"Stands for ``{{func: {target.name}{shape}{params}}}``."


def _written(name: str, given: Any) -> str:
    if given is None:
        return name
    if isinstance(given, P):
        return f"{{{name}: {'...' if given.name == '*' else given.name.upper()}}}"
    if isinstance(given, Mapping):
        inner = ", ".join(f"{k}: {_yaml(v)}" for k, v in given.items())
        return f"{{{name}: {{{inner}}}}}"
    return f"{{{name}: {_yaml(given)}}}"


def _yaml(value: Any) -> str:
    if isinstance(value, P):
        return value.name.upper()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_yaml, value))}]"
    return {float("inf"): ".inf", float("-inf"): "-.inf"}.get(value, str(value))
