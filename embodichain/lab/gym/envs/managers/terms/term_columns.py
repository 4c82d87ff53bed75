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
        named = all(labels)
        if isinstance(value, Mapping):
            if not named:
                message = "the columns have no names that a map could give: write a number, or a "
                message += f"list of {width}"
                raise ConfigError([Problem(path, message)])
            return per_joint(dict(value), labels, path, self.what)
        if not isinstance(value, list):
            return float(value)
        if named and self.named_by and len(self.names) == width:
            value = in_columns(value, labels, self.named_by, path, self.what)
        elif named and self.named_by:
            self._require_plain_order(value, path)
        if len(value) != width:
            message = f"has {len(value)} values; the last dimension of the value is {width}"
            raise ConfigError([Problem(path, message)])
        return np.asarray(value, np.float64)

    def _require_plain_order(self, value: Sequence[Any], path: str) -> None:
        """Refuse a list of several numbers a name if names are not written in their order."""
        written = tuple(name for entry in self.named_by for name in entry.names)
        plain = all(len(entry.names) == 1 or entry.is_part for entry in self.named_by)
        if plain and written == self.names:
            return
        order = ", ".join(self.names)
        message = f"a list needs plain names in the order of the columns, which is {order}"
        hint = f"Write {map_to_write(path, self.names, value)}"
        raise ConfigError([Problem(path, message, hint)])


def columns_of_term(
    env: TermContext, given: Mapping[str, Any], values: Mapping[str, Any], hints: Mapping[str, Any]
) -> TermColumns:
    """The names of a term's columns, by what its parameters refer to.

    Args:
        env: The environment.
        given: The parameters as declared.
        values: The parameters with references resolved.
        hints: Parameter -> type.
    """
    found = []
    for key, value in values.items():
        marks = list(references(hints.get(key)))
        if isinstance(value, ResolvedEntity):
            found.append(_of_entity(value, of_bodies(marks)))
        elif hasattr(value, "plan") and hasattr(value, "reads"):
            plan = value.plan
            what = "joint" if plan.joints else plan.kind
            found.append(TermColumns(plan.names or (value.uid,), plan.named_by, what))
        elif of_command(marks) and value is not None:
            found.append(TermColumns(tuple(env.command_manager.names(given[key]))))
    if len(found) < 2:
        return found[0] if found else TermColumns()
    if all(len(one.names) == 1 for one in found):
        return TermColumns((" to ".join(one.names[0] for one in found),))
    return TermColumns()


def _of_entity(entity: ResolvedEntity, bodies: bool) -> TermColumns:
    if entity.joint_ids and not bodies and not entity.frame_names:
        return TermColumns(entity.joint_names, entity.joints_by, "joint", in_turn=True)
    return TermColumns(entity.frame_names or (entity.uid,), entity.frames_by, entity.kind)
