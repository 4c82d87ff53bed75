"""`TermColumns`: the joints, links or other names that the columns of a term's value belong to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import of_bodies, of_command, references
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.terms.per_name import in_columns, map_to_write, per_joint
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.compiler.names import NamedBy
    from embodichain.utils.array_types import Floats

__all__ = ["TermColumns", "columns_of_term"]


@dataclass(frozen=True)
class TermColumns:
    """Names of the columns of a value, (N, K) or with more dimensions.

    Attributes:
        names: Names of joints, links or other things, in the order of the columns; a value has one
            column or several for each. Empty if they are not known.
        named_by: The entries of the reference that name them; none picks all.
        what: The kind of the names, for messages.
        in_turn: Whether several columns a name come in turn (a, b, a, b), not side by side.
    """

    names: tuple[str, ...] = ()
    named_by: tuple[NamedBy, ...] = ()
    what: str = "column"
    in_turn: bool = False

    def labels(self, count: int) -> list[str]:
        """Names of the columns of a flattened value; empty where they are not known.

        Args:
            count: Number of its columns.
        """
        if not self.names or count % len(self.names):
            return [""] * count
        each = count // len(self.names)
        if self.in_turn:
            return list(self.names) * each
        return [name for name in self.names for _ in range(each)]

    def numbers(self, value: Any, shape: tuple[int, ...], path: str) -> Floats | float:
        """One number for each entry of the last dimension, (K,), or one for all.

        Args:
            value: A number, a list, or {name regex: number}.
            shape: Shape of one environment's value.
            path: Key path, for messages.

        Raises:
            ConfigError: If a list or a map is wrong (see `in_columns`, `per_joint`).
        """
        width = shape[-1] if shape else 1
        labels = self.labels(width) if len(shape) == 1 else [""] * width
        has_names = all(labels)
        if isinstance(value, Mapping):
            if not has_names:
                message = (
                    "the columns have no names that a map could give: write a number, or a "
                    f"list of {width}"
                )
                raise ConfigError([Problem(path, message)])
            return per_joint(dict(value), labels, path, self.what)
        if not isinstance(value, list):
            return float(value)
        if has_names and self.named_by:
            if len(self.names) == width:
                value = in_columns(value, labels, self.named_by, path=path, what=self.what)
            else:
                self._require_plain_order(value, path)
        if len(value) != width:
            message = f"has {len(value)} values; the last dimension of the value is {width}"
            raise ConfigError([Problem(path, message)])
        return np.asarray(value, np.float64)

    def _require_plain_order(self, value: Sequence[Any], path: str) -> None:
        """Refuse a list of several numbers a name if names are not written in their order."""
        written: list[str] = []
        for entry in self.named_by:
            written += entry.names
        are_plain = all(len(entry.names) == 1 or entry.is_part for entry in self.named_by)
        if are_plain and tuple(written) == self.names:
            return
        order = ", ".join(self.names)
        message = f"a list needs plain names in the order of the columns, which is {order}"
        hint = f"Write {map_to_write(path, self.names, value)}"
        raise ConfigError([Problem(path, message, hint)])


def columns_of_term(
    env: TermContext, given: Mapping[str, Any], values: Mapping[str, Any], hints: Mapping[str, Any]
) -> TermColumns:
    """Return the names of a term's columns, by what its parameters refer to.

    Args:
        env: The environment.
        given: The parameters as declared.
        values: The parameters with references resolved.
        hints: Parameter -> type.
    """
    columns: list[TermColumns] = []
    for key, value in values.items():
        marks = list(references(hints.get(key)))
        if isinstance(value, ResolvedEntity):
            columns.append(_of_entity(value, of_bodies(marks)))
        elif hasattr(value, "plan") and hasattr(value, "reads"):
            plan = value.plan
            columns.append(
                TermColumns(
                    names=plan.names or (value.uid,),
                    named_by=plan.named_by,
                    what="joint" if plan.joints else plan.kind,
                )
            )
        elif of_command(marks) and value is not None:
            columns.append(TermColumns(tuple(env.command_manager.names(given[key]))))
    if len(columns) == 1:
        return columns[0]
    # One thing to another, as a distance: its columns belong to both.
    if columns and all(len(of_one.names) == 1 for of_one in columns):
        return TermColumns((" to ".join(of_one.names[0] for of_one in columns),))
    return TermColumns()


def _of_entity(entity: ResolvedEntity, picks_bodies: bool) -> TermColumns:
    """Return the names of an entity's joints, or of its links, sites or geoms."""
    if entity.joint_ids and not picks_bodies and not entity.frame_names:
        return TermColumns(entity.joint_names, entity.joints_by, "joint", in_turn=True)
    return TermColumns(entity.frame_names or (entity.uid,), entity.frames_by, entity.kind)
