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

_AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the columns of a tool's pose or motion."""


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
        centre: The value of the action 0, of a delta the change; words where it is not a number.
        scale: Change of the value per unit of action; words where it is not a number.
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


@dataclass(frozen=True, slots=True)
class _TermColumns:
    """The columns of one action term, as it describes them.

    Attributes:
        names: Their names.
        centres: The centre of each.
        scales: The scale of each.
        meaning: What they command.
    """

    names: list[str]
    centres: Sequence[float | str]
    scales: Sequence[float | str]
    meaning: ActionMeaning

    @property
    def quantities(self) -> tuple[str, ...]:
        """What each commands."""
        return self.meaning.of("quantity", len(self.names))

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each."""
        return self.meaning.of("units", len(self.names))


def action_columns(env: BaseEnv) -> list[ActionColumn]:
    """The columns of an environment's action, in order.

    Empty if the environment's class defines its action space itself: it says what it means.
    """
    if len(env.action_manager):
        terms = [_columns_of_term(env, name) for name in env.action_manager.terms]
        for name, term in zip(env.action_manager.terms, terms, strict=True):
            _require_lengths(name, term)
    elif env.robot is not None:
        terms = [_joint_positions(env)]
    else:
        return []
    space: Any = env.single_action_space
    if space.shape != (sum(len(term.names) for term in terms),):
        return []
    lows = iter(space.low.tolist())
    highs = iter(space.high.tolist())
    columns: list[ActionColumn] = []
    for term in terms:
        meaning = term.meaning
        for i, name in enumerate(term.names):
            column = ActionColumn(
                name=name,
                quantity=term.quantities[i],
                mode=meaning.mode,
                reference=meaning.reference,
                frame=meaning.frame,
                centre=_centre(term.centres[i], meaning),
                scale=_plain(term.scales[i]),
                unit=term.units[i],
                low=next(lows),
                high=next(highs),
            )
            columns.append(column)
    return columns


def _columns_of_term(env: BaseEnv, name: str) -> _TermColumns:
    """Return the columns of an action term, which need not be a subclass of `ActionTerm`."""
    instance = env.action_manager.terms[name].instance
    centres: Sequence[float | str] = [""] * len(instance.low)
    scales: Sequence[float | str] = [""] * len(instance.low)
    if hasattr(instance, "centre_and_scale"):
        centres, scales = instance.centre_and_scale()
    meaning = instance.meaning() if hasattr(instance, "meaning") else None
    if not isinstance(meaning, ActionMeaning):
        meaning = ActionMeaning()
    return _TermColumns(_names(env, name), centres, scales, meaning)


def _joint_positions(env: BaseEnv) -> _TermColumns:
    """Return the columns of a robot that has no action terms: joint positions as they are."""
    robot: Any = env.robot
    joint_ids = env.active_joint_ids
    units = joint_units(robot, joint_ids)
    return _TermColumns(
        names=[robot.joint_names[i] for i in joint_ids],
        centres=[0.0] * len(joint_ids),
        scales=[1.0] * len(joint_ids),
        meaning=ActionMeaning("joint position", "absolute", units=units),
    )


def _require_lengths(name: str, term: _TermColumns) -> None:
    """Refuse a term that describes another number of columns than it has."""
    count = len(term.names)
    lengths = {
        "centre": len(term.centres),
        "scale": len(term.scales),
        "quantity": len(term.quantities),
        "units": len(term.units),
    }
    for description, length in lengths.items():
        if length != count:
            message = f"says {length} of {description} for {count} columns of its action"
            raise ConfigError([Problem(f"actions.{name}.func", message)])


def _names(env: BaseEnv, name: str) -> list[str]:
    """``TERM/COLUMN``; the term alone if its only column is named after no joint or control."""
    columns = env.action_manager.columns_of(name)
    if len(columns) == 1:
        named_after = set(_AXES)
        for asset in {**env.sim.robots, **env.sim.articulations}.values():
            named_after.update(asset.parsed.joint_names, asset.parsed.control_names)
        if columns[0] not in named_after:
            return [name]
    return [f"{name}/{column}" for column in columns]


def _centre(centre: Any, meaning: ActionMeaning) -> float | str:
    """The centre; of a delta without the words for its reference, which is another attribute."""
    if meaning.mode == "delta" and isinstance(centre, str):
        if centre == meaning.reference:
            return 0.0
        words = f"{meaning.reference} + "
        if centre.startswith(words):
            return float(centre.removeprefix(words))
    return _plain(centre)


def _plain(value: Any) -> float | str:
    return value if isinstance(value, str) else float(value)
