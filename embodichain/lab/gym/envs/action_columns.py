"""`action_columns`: what each number of an action means, for tables, logs and data sets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.managers.term import ActionMeaning, joint_units
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["ActionColumn", "action_columns"]

_Line = tuple[Sequence[float | str], Sequence[float | str]]
"""Centre and scale of each column."""


@dataclass(frozen=True, slots=True)
class ActionColumn:
    """One number of an action: the commanded value is centre + scale x action, in `unit`.

    Attributes:
        name: ``TERM/JOINT``, ``tool/x``, or the term alone where its only number is of no joint
            (``gripper``).
        quantity: What is commanded, such as ``tool position``; empty if the term does not say.
        mode: ``absolute``, or ``delta``: a change from `reference` in each control step; empty if
            the term does not say.
        reference: What a delta is added to: ``target`` or ``qpos``; empty of absolute values.
        frame: The axes of a pose or motion: ``base``, ``world`` or ``tool``; else empty.
        centre: The value of the action 0, of a delta the change; words where it is no number.
        scale: Change of the value per unit of action; words where it is no number.
        unit: Of the value; empty if there is none, or the term does not say.
        low: Lowest action.
        high: Highest action.
    """

    name: str
    quantity: str
    mode: str
    reference: str
    frame: str
    centre: float | str
    scale: float | str
    unit: str
    low: float
    high: float

    @property
    def about(self) -> float | str:
        """The centre in one word or number, for tables: ``target``, ``qpos + 0.1``, ``0.5``."""
        if not self.reference or isinstance(self.centre, str):
            return self.centre
        return f"{self.reference} + {self.centre:g}" if self.centre else self.reference

    def to_dict(self) -> dict[str, Any]:
        """The attributes by name."""
        return asdict(self)


def action_columns(env: BaseEnv) -> list[ActionColumn]:
    """The columns of an environment's action, in order.

    Empty if the environment's class defines its action space itself: it says what it means.
    """
    manager, space = env.action_manager, env.single_action_space
    parts: list[tuple[list[str], _Line, ActionMeaning]]
    if len(manager):
        parts = [
            (_names(env, name), _line(term.instance), _meaning(term.instance))
            for name, term in manager.terms.items()
        ]
        _require_lengths(list(manager.terms), parts)
    elif env.robot is not None:  # joint positions as they are
        names = [env.robot.joint_names[i] for i in env.active_joint_ids]
        line: _Line = [0.0] * len(names), [1.0] * len(names)
        units = joint_units(env.robot, env.active_joint_ids)
        parts = [(names, line, ActionMeaning("joint position", "absolute", units=units))]
    else:
        return []
    found: list[tuple[Any, ...]] = []
    for names, (centres, scales), meaning in parts:
        quantities, units = (meaning.of(part, len(names)) for part in ("quantity", "units"))
        about = meaning.mode, meaning.reference, meaning.frame
        for name, quantity, centre, scale, unit in zip(
            names, quantities, centres, scales, units, strict=True
        ):
            value = _centre(centre, meaning), _plain(scale)
            found.append((name, quantity, *about, *value, unit))
    if space.shape != (len(found),):
        return []
    low, high = (end.tolist() for end in (space.low, space.high))  # type: ignore[attr-defined]
    return [ActionColumn(*row, *ends) for row, *ends in zip(found, low, high, strict=True)]


def _require_lengths(
    terms: Sequence[str], parts: Sequence[tuple[list[str], _Line, ActionMeaning]]
) -> None:
    """Refuse terms that describe another number of columns than they have."""
    for term, (names, (centres, scales), meaning) in zip(terms, parts, strict=True):
        count = len(names)
        given = {
            "centre": centres,
            "scale": scales,
            "quantity": meaning.of("quantity", count),
            "units": meaning.of("units", count),
        }
        for what, values in given.items():
            if len(values) != count:
                message = f"says {len(values)} of {what} for {count} columns of its action"
                raise ConfigError([Problem(f"actions.{term}.func", message)])


def _line(term: Any) -> _Line:
    """Centre and scale of a term's columns; a term need not be a subclass of `ActionTerm`."""
    if hasattr(term, "centre_and_scale"):
        return term.centre_and_scale()
    return [""] * len(term.low), [""] * len(term.low)


def _meaning(term: Any) -> ActionMeaning:
    found = term.meaning() if hasattr(term, "meaning") else None
    return found if isinstance(found, ActionMeaning) else ActionMeaning()


def _names(env: BaseEnv, name: str) -> list[str]:
    """``TERM/COLUMN``; the term alone if its only column is named after no joint or control."""
    columns = env.action_manager.columns_of(name)
    if len(columns) == 1:
        assets = {**env.sim.robots, **env.sim.articulations}.values()
        parsed = [asset.parsed for asset in assets]
        known = {n for one in parsed for n in (*one.joint_names, *one.control_names)}
        if columns[0] not in {*known, *_AXES}:
            return [name]
    return [f"{name}/{column}" for column in columns]


_AXES = ("x", "y", "z", "rx", "ry", "rz")


def _centre(given: Any, meaning: ActionMeaning) -> float | str:
    """The centre; of a delta without the words for its reference, which is another attribute."""
    if meaning.mode == "delta" and isinstance(given, str):
        if given == meaning.reference:
            return 0.0
        words = f"{meaning.reference} + "
        if given.startswith(words):
            return float(given.removeprefix(words))
    return _plain(given)


def _plain(value: Any) -> float | str:
    return value if isinstance(value, str) else float(value)
