"""The page of licences, docs/licences.md, from locked.txt; `make pins` writes it."""

import re
from collections.abc import Iterable
from pathlib import Path

from scripts.locked import CUDA, RUN, Package, of_sets

PAGE = Path(__file__).parents[1] / "docs" / "licences.md"
DEVELOPMENT = ("dev", "docs")
"""Extras that users do not need."""
_HEAD = """\
# Licences of the dependencies

embodichain is under the MIT licence. These packages are not part of it: pip installs them beside
it. The versions are those that the tests run with, the licences what each package states of itself,
by its SPDX expression where it has one. `make pins` writes this page; the bill of materials of a
release says the same to programs ([releases](releases.md#what-a-release-consists-of)).
"""
_RECIPROCAL = re.compile(r"GPL|MPL|Mozilla|Lesser")


def page(packages: Iterable[Package]) -> str:
    """Write the page.

    Args:
        packages: All that is locked.
    """
    packages = list(packages)
    user_packages = released(packages)
    with_extra = [(*_row(p), ", ".join(extras_of(p))) for p in user_packages if extras_of(p)]
    development = [_row(p) for p in packages if p not in user_packages]
    columns = "package | version | licence"
    parts = [
        _HEAD,
        _list_reciprocal(user_packages),
        "## Always installed\n",
        _table(columns, [_row(p) for p in of_sets(packages, [RUN])]),
        "## With an extra\n",
        _table(f"{columns} | extras", with_extra),
        "## With the CUDA build of PyTorch\n",
        "PyTorch asks for them itself, on Linux.\n",
        _table(columns, [_row(p) for p in of_sets(packages, [CUDA])]),
        "## For development only\n",
        _table(columns, development),
    ]
    return "\n".join(parts)


def extras_of(package: Package) -> list[str]:
    """Return the extras for users that install a package; empty if it is always installed."""
    return [name for name in package.sets if name not in (RUN, CUDA, *DEVELOPMENT)]


def released(packages: Iterable[Package]) -> list[Package]:
    """Return the packages that a user may install, of all that are locked."""
    return [package for package in packages if not set(package.sets) <= set(DEVELOPMENT)]


def _row(package: Package) -> tuple[str, ...]:
    return package.name, package.version, package.licence


def _list_reciprocal(packages: list[Package]) -> str:
    """Name the licences that ask something of those who pass on a changed package."""
    names = [f"{p.name} ({p.licence})" for p in packages if _RECIPROCAL.search(p.licence)]
    return (
        "Whoever passes on a changed copy of these does so under the same licence:\n"
        f"{', '.join(names)}.\nNVIDIA's packages have terms of their own.\n"
    )


def _table(head: str, rows: list[tuple[str, ...]]) -> str:
    columns = head.count("|") + 1
    lines = [f"| {head} |", f"| {' | '.join(['---'] * columns)} |"]
    lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(lines) + "\n"
