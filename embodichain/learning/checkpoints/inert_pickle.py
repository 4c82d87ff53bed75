"""`read_inert`: what a pickle contains, without running anything of it.

A pickle is a program: it names functions and classes, and calls them. Here each name becomes an
empty stand-in class that only notes what it is called with. Nothing is imported, and no function
that the pickle names is called.
"""

from __future__ import annotations

import io
import pickle
from dataclasses import dataclass, field
from typing import Any

__all__ = ["Inert", "InertPickle", "read_inert"]


_DAMAGE = (
    pickle.UnpicklingError,
    AttributeError,
    EOFError,
    ImportError,
    LookupError,
    MemoryError,
    OverflowError,
    RecursionError,
    TypeError,
    ValueError,
)
"""What a malformed pickle raises."""


class Inert:
    """An object that a pickle would make; its class, a subclass of this, is what makes it.

    Attributes:
        made_by: ``module.name`` of the function or class, of the subclasses.
        arguments: What it is called with.
        state: What the object is filled with afterwards; None if with nothing.
        entries: Key -> value, put into it as into a dict.
        members: Values put into it as into a list or a set.
    """

    made_by = ""
    arguments: tuple[Any, ...]
    state: Any
    entries: dict[Any, Any]
    members: list[Any]

    def __new__(cls, *arguments: Any, **named: Any) -> Inert:
        """Note the arguments; those with names come last, as one dict."""
        self = super().__new__(cls)
        self.arguments = (*arguments, named) if named else arguments
        self.state = None
        self.entries = {}
        self.members = []
        return self

    def __init__(self, *arguments: Any, **named: Any) -> None:
        """Do nothing: all is noted already."""

    def __setstate__(self, state: Any) -> None:
        """Note the state."""
        self.state = state

    def __setitem__(self, key: Any, value: Any) -> None:
        """Note an entry."""
        self.entries[key] = value

    def append(self, value: Any) -> None:
        """Note a member."""
        self.members.append(value)

    def extend(self, values: Any) -> None:
        """Note members."""
        self.members += values

    add = append


@dataclass
class InertPickle:
    """The content of a pickle.

    Attributes:
        value: Plain values, with an `Inert` object for each one that a function or class makes,
            and a subclass of `Inert` for each function or class itself; None if it is damaged.
        names: ``module.name`` of every function and class that it names, in their order.
        damage: Why it cannot be read to its end; empty if it can.
    """

    value: Any = None
    names: list[str] = field(default_factory=list)
    damage: str = ""


def read_inert(data: bytes) -> InertPickle:
    """Read a pickle without running anything of it.

    Args:
        data: The pickle; of a damaged one, `names` has those before the damage.
    """
    content = InertPickle()
    try:
        content.value = _Reader(data, content.names).load()
    except _DAMAGE as error:
        content.damage = f"{type(error).__name__}: {error}"
    return content


class _Reader(pickle.Unpickler):
    """An unpickler for which every name is a stand-in."""

    def __init__(self, data: bytes, names: list[str]) -> None:
        super().__init__(io.BytesIO(data))
        self._names = names
        self._classes: dict[str, type[Inert]] = {}

    def find_class(self, module: str, name: str) -> type[Inert]:
        """Return the stand-in of a function or class; called for every name of the pickle."""
        made_by = f"{module}.{name}"
        if made_by not in self._classes:
            self._names.append(made_by)
            self._classes[made_by] = type("Inert", (Inert,), {"made_by": made_by})
        return self._classes[made_by]
