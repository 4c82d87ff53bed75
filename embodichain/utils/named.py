"""`Named`: a dict whose error for an unknown name says which names there are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NoReturn, TypeVar

from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["Named", "unknown_name"]

V = TypeVar("V")


class Named(dict[str, V]):
    """A dict from names to things of one kind.

    Args:
        noun: What the things are, in one word or two: ``robot``.
        entries: The first entries.
    """

    def __init__(self, noun: str, entries: Mapping[str, V] | None = None) -> None:
        super().__init__(entries or {})
        self.noun = noun

    def __missing__(self, name: str) -> NoReturn:
        """Refuse a name that does not exist.

        Raises:
            KeyError: Always; lists the names, with the closest match.
        """
        raise unknown_name(self.noun, name, self)

    def __reduce__(self) -> tuple[object, ...]:
        """Copy and pickle with the noun."""
        return type(self), (self.noun, dict(self))


def unknown_name(noun: str, name: object, names: Iterable[str]) -> KeyError:
    """Return the error for a name that does not exist.

    Args:
        noun: What was looked for.
        name: The name.
        names: The names that exist.
    """
    names = list(names)
    text = f"no {noun} {name!r}; there are: {listing(names, str(name))}"
    hint = did_you_mean(str(name), names)
    return KeyError(f"{text}.{hint}" if hint else text)
