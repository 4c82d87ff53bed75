"""Write into docs/compatibility.md which of EmbodiChain's public names are here, and what to use.

`python scripts/names_table.py` writes the tables of `embodichain.compat.names` between two marks.
"""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from embodichain.compat.names import reason, upstream_modules, upstream_names

PAGE = Path(__file__).parents[1] / "docs" / "compatibility.md"
BEGIN = "<!-- names: begin -->\n"
END = "<!-- names: end -->\n"
_ROOT = "embodichain."


def _import_name(module: str, name: str) -> Any:
    """Return what a name stands for here; None if it is refused."""
    try:
        return getattr(importlib.import_module(module), name)
    except NotImplementedError:
        return None


def tables() -> str:
    """Return two tables: the names that are here by module, and the others by what to use."""
    names_here: dict[str, list[str]] = {}  # by module
    missing: dict[str, Counter[str]] = {}  # reason -> names of each module
    unbuilt: set[str] = set()
    for module in sorted(upstream_modules()):
        for name in sorted(upstream_names(module)):
            value = _import_name(module, name)
            if value is None:
                missing.setdefault(reason(module, name), Counter())[module] += 1
                continue
            names_here.setdefault(module, []).append(name)
            if getattr(value, "__module__", "").endswith(".unavailable"):
                unbuilt.add(name)
    count_here = sum(map(len, names_here.values()))
    count_missing = sum(counts.total() for counts in missing.values())
    count = count_here + count_missing
    lines = [
        f"{count_here} of {count} are here, under these paths (`embodichain.` left out). "
        "Building a",
        f"{_as_code(sorted(unbuilt))} raises `NotImplementedError`.",
        "",
        "| module | names |",
        "| --- | --- |",
    ]
    for module, names in names_here.items():
        lines.append(f"| `{_short(module)}` | {_as_code(names)} |")
    lines += [
        "",
        f"The other {count_missing} raise `NotImplementedError` when they are imported:",
        "",
        "| module, and how many of its names | use instead, or why |",
        "| --- | --- |",
    ]
    for text, counts in sorted(missing.items(), key=lambda item: min(item[1])):
        lines.append(f"| {_list_modules(counts)} | {text} |")
    return "\n".join(lines) + "\n"


def _as_code(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _short(module: str) -> str:
    return module.removeprefix(_ROOT)


def _list_modules(counts: Mapping[str, int]) -> str:
    """List modules with their counts; a package of which all names are missing is one entry."""
    entries: Counter[str] = Counter()
    for module, count in counts.items():
        entries[_largest_missing(module, counts)] += count
    return ", ".join(f"`{_short(name)}` {count}" for name, count in entries.items())


def _largest_missing(module: str, counts: Mapping[str, int]) -> str:
    """Return the highest package around a module that lacks all names, else the module."""
    parts = module.split(".")
    for depth in range(2, len(parts) + 1):
        package = ".".join(parts[:depth])
        if _is_all_missing(package, counts):
            return package
    return module


def _is_all_missing(package: str, counts: Mapping[str, int]) -> bool:
    """Whether all names of a package and of its modules are missing, for the same reason."""
    modules = [m for m in upstream_modules() if m == package or m.startswith(f"{package}.")]
    return all(counts.get(m, 0) == len(upstream_names(m)) for m in modules)


def filled(text: str) -> str:
    """Return a page with the tables between the marks."""
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}{tables()}{END}{tail}"


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
