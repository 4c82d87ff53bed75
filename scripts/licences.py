"""The page of licences, docs/licences.md, from locked.txt; `make pins` writes it."""

import re
from collections.abc import Iterable
from pathlib import Path

from scripts.locked import CUDA, RUN, Package, of_sets

PAGE = Path(__file__).parents[1] / "docs" / "licences.md"
DEVELOPMENT = ("dev", "docs")
"""Extras that no user needs."""
_HEAD = """\
# Licences of the dependencies

embodichain is under the MIT licence. These packages are not part of it: pip installs them beside
it. The versions are those that the tests run with, the licences what each package states of itself,
by its SPDX expression where it has one. `make pins` writes this page; the bill of materials of a
release says the same to programs ([releases](releases.md#what-a-release-consists-of)).
"""
_RECIPROCAL = re.compile(r"GPL|MPL|Mozilla|Lesser")


def page(packages: Iterable[Package]) -> str:
    """The page.

    Args:
        packages: All that is locked.
    """
    packages = list(packages)
    always, cuda = of_sets(packages, [RUN]), of_sets(packages, [CUDA])
    extras = [p for p in released(packages) if extras_of(p)]
    rest = [p for p in packages if p not in released(packages)]
    columns = "package | version | licence"
    parts = [
        _HEAD,
        _reciprocal(released(packages)),
        "## Always installed\n",
        _table(columns, [_row(p) for p in always]),
        "## With an extra\n",
        _table(f"{columns} | extras", [(*_row(p), ", ".join(extras_of(p))) for p in extras]),
        "## With the CUDA build of PyTorch\n",
        "PyTorch asks for them itself, on Linux.\n",
        _table(columns, [_row(p) for p in cuda]),
        "## For development only\n",
        _table(columns, [_row(p) for p in rest]),
    ]
    return "\n".join(parts)


def extras_of(package: Package) -> list[str]:
    """The extras of users that bring a package; empty if they have it without."""
    return [name for name in package.sets if name not in (RUN, CUDA, *DEVELOPMENT)]


def released(packages: Iterable[Package]) -> list[Package]:
    """What a user may install, of all that is locked."""
    return [p for p in packages if not set(p.sets) <= set(DEVELOPMENT)]


def _row(package: Package) -> tuple[str, ...]:
    return package.name, package.version, package.licence


def _reciprocal(users: list[Package]) -> str:
    """Names the licences that ask something of who passes a changed package on."""
    found = [f"{p.name} ({p.licence})" for p in users if _RECIPROCAL.search(p.licence)]
    return (
        "Whoever passes on a changed copy of these does so under the same licence:\n"
        f"{', '.join(found)}.\nNVIDIA's packages have terms of their own.\n"
    )


def _table(head: str, rows: list[tuple[str, ...]]) -> str:
    columns = head.count("|") + 1
    lines = [f"| {head} |", "| " + " | ".join(["---"] * columns) + " |"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)]) + "\n"
