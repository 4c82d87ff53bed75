"""Writes into docs/compatibility.md which of EmbodiChain's public names are here, and what to use.

`python scripts/names_table.py`: `embodichain.compat.names`, between two marks.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from embodichain.compat.names import reason, upstream_modules, upstream_names

PAGE = Path(__file__).parents[1] / "docs" / "compatibility.md"
BEGIN, END = "<!-- names: begin -->\n", "<!-- names: end -->\n"
_ROOT = "embodichain."


def _found(module: str, name: str) -> Any:
    """What the name is here; None if it is refused."""
    try:
        return getattr(importlib.import_module(module), name)
    except NotImplementedError:
        return None


def tables() -> str:
    """Return two tables: the names that are here by module, and the others by what to use."""
    here: dict[str, list[str]] = {}
    missing: dict[str, dict[str, int]] = {}
    unbuilt: set[str] = set()
    count = 0
    for module in sorted(upstream_modules()):
        for name in sorted(upstream_names(module)):
            count += 1
            found = _found(module, name)
            if getattr(found, "__module__", "").endswith(".unavailable"):
                unbuilt.add(name)
            if found is not None:
                here.setdefault(module, []).append(name)
            else:
                places = missing.setdefault(reason(module, name), {})
                places[module] = places.get(module, 0) + 1
    there = sum(map(len, here.values()))
    lines = [
        f"{there} of {count} are here, under these paths (`embodichain.` left out). Building a",
        f"{', '.join(f'`{name}`' for name in sorted(unbuilt))} raises `NotImplementedError`.",
        "",
        "| module | names |",
        "| --- | --- |",
        *(f"| `{_short(m)}` | {', '.join(f'`{n}`' for n in names)} |" for m, names in here.items()),
        "",
        f"The other {count - there} raise `NotImplementedError` when they are imported:",
        "",
        "| module, and how many of its names | use instead, or why |",
        "| --- | --- |",
        *(
            f"| {_places(places)} | {text} |"
            for text, places in sorted(missing.items(), key=_first)
        ),
    ]
    return "\n".join(lines) + "\n"


def _short(module: str) -> str:
    return module.removeprefix(_ROOT)


def _first(item: tuple[str, dict[str, int]]) -> str:
    return min(item[1])


def _places(places: dict[str, int]) -> str:
    """Modules with counts, those of one package that are all missing as one."""
    grouped: dict[str, int] = {}
    for module, count in places.items():
        parts = module.split(".")
        whole = next(
            (
                ".".join(parts[:depth])
                for depth in range(2, len(parts) + 1)
                if _all_missing(".".join(parts[:depth]), places)
            ),
            module,
        )
        grouped[whole] = grouped.get(whole, 0) + count
    return ", ".join(f"`{_short(m)}` {count}" for m, count in grouped.items())


def _all_missing(package: str, places: dict[str, int]) -> bool:
    inside = [m for m in upstream_modules() if m == package or m.startswith(f"{package}.")]
    return all(places.get(m, 0) == len(upstream_names(m)) for m in inside)


def filled(text: str) -> str:
    """Return a page with the tables between the marks."""
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}{tables()}{END}{tail}"


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
