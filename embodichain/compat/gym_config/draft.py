"""`Draft`: a task during conversion, the origin of its parts, and what is left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

from embodichain.compat.gym_config.vocabulary import HANDLED, Vocabulary
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["Draft", "Path"]

Path = tuple[str, ...]
"""Keys and indices from the root, with indices as strings."""


class Draft:
    """The intermediate result of a conversion.

    Args:
        ours: Whether keys of this package are allowed besides those of the tables; they are checked
            with the task.

    Attributes:
        task: The task; plain values.
        origins: Path in the task -> path in the gym config, for whole subtrees.
        notes: What was left out and why; paths are the gym config's.
        problems: The mistakes in the gym config.
    """

    def __init__(self, ours: bool = False) -> None:
        self.ours = ours
        self.task: dict[str, Any] = {}
        self.origins: dict[Path, Path] = {}
        self.notes: list[Problem] = []
        self.problems: list[Problem] = []

    def put(self, target: Path, value: Any, source: Path) -> None:
        """Set a value; missing maps of its path are created."""
        parent = self.task
        for key in target[:-1]:
            parent = parent.setdefault(key, {})
        parent[target[-1]] = value
        self.origins[target] = source

    def note(self, source: Path, message: str) -> None:
        """Add a note that something is left out or changed."""
        self.notes.append(Problem(".".join(source), message))

    def refuse(self, source: Path, message: str, hint: str = "") -> None:
        """Add a problem."""
        self.problems.append(Problem(".".join(source), message, hint.strip()))

    def apply_rules(self, data: Any, source: Path, target: Path, vocabulary: Vocabulary) -> bool:
        """Apply a table's rules to the keys of a map; keys that are `HANDLED` are not touched.

        Args:
            data: The map; any other type is refused.
            source: Its path.
            target: Path in the task of the map that gets the keys.
            vocabulary: The table.

        Returns:
            Whether `data` is a map.
        """
        if not isinstance(data, Mapping):
            self.refuse(source, f"expected a map, got {data!r}")
            return False
        for key, value in data.items():
            rule = vocabulary.get(str(key))
            where = (*source, str(key))
            if rule is None and self.ours:
                self.put((*target, str(key)), value, where)
            elif rule is None:
                self.refuse_key(where, vocabulary)
            elif isinstance(rule, str):
                is_empty = value is None or value == [] or value == {}  # nothing is left out
                if not is_empty:
                    self.note(where, rule)
            elif rule is not HANDLED:
                self.put((*target, str(key)), value, where)
        return True

    def refuse_key(self, where: Path, allowed: Mapping[str, Any]) -> None:
        """Refuse an unknown key; suggests the closest known one."""
        hint = did_you_mean(where[-1], allowed)
        self.refuse(where, f"unknown key; known: {', '.join(allowed)}.", hint)

    def add_entity(
        self, data: Any, source: Path, section: str, fallback: str | None = None
    ) -> Path | None:
        """Add an element of a list of entities to the task, still empty, under its unique uid.

        Args:
            data: The element.
            source: Its path.
            section: The map of entities that it is added to.
            fallback: A key with a file; the stem is the name of an element without uid.

        Returns:
            Its path in the task; None if it has no uid, or another entity has the same.
        """
        uid: Any = None
        if isinstance(data, Mapping):
            uid = data.get("uid")
            file = None if fallback is None else data.get(fallback)
            if not uid and isinstance(file, str):
                uid = PurePosixPath(file.replace("\\", "/")).stem
        if not isinstance(uid, str) or not uid:
            self.refuse((*source, "uid"), "missing value: the name of the entity")
            return None
        if uid in self.task.get(section, {}):
            self.refuse((*source, "uid"), f"another entity is called {uid!r} already")
            return None
        self.put((section, uid), {}, source)
        return section, uid

    def items(self, data: Any, source: Path) -> Iterator[tuple[Path, Any]]:
        """The elements of a list with their paths; None is empty, other types are refused."""
        if data is not None and not isinstance(data, list):
            self.refuse(source, f"expected a list, got {data!r}")
        elif data is not None:
            for i, value in enumerate(data):
                yield (*source, str(i)), value

    def entries(self, data: Any, source: Path) -> Iterator[tuple[Path, str, Any]]:
        """The values of a map with their paths and names; None is empty, others are refused."""
        if data is not None and not isinstance(data, Mapping):
            self.refuse(source, f"expected a map, got {data!r}")
        elif data is not None:
            for key, value in data.items():
                yield (*source, str(key)), str(key), value
