"""The table of docs/robots.md is the catalogue that the compiler's tests go by."""

from pathlib import Path

from tests.data.robot_catalog import (
    LOADABLE,
    NOT_LOADABLE,
    VISUALS_UNREADABLE,
    WITH_MENDED_INERTIA,
)

PAGE = Path(__file__).parents[2] / "docs" / "robots.md"
NO_LINKS = "ur_description/urdf/ur3.urdf"  # compiles, but holds macros only
REASONS = {
    "no decoder found for mesh file": "collision meshes are COLLADA (`.dae`)",
    "mesh volume is too small": "a collision mesh without volume",
    "number of faces should be between 1 and 200000": "an STL file that cannot be read",
    "inertia must have positive eigenvalues": "an inertia that cannot be mended",
}


def notes(name: str) -> str:
    if name == NO_LINKS:
        return "**not loaded**: it has no links"
    if name in NOT_LOADABLE:
        return f"**not loaded**: {REASONS[NOT_LOADABLE[name]]}"
    found = ["inertias are mended"] if name in WITH_MENDED_INERTIA else []
    found += ["drawn by its collision shapes"] if name in VISUALS_UNREADABLE else []
    return "; ".join(found)


def table() -> str:
    lines = ["| robot | joints | |", "| --- | --- | --- |"]
    for name in sorted([*LOADABLE, *NOT_LOADABLE]):
        loaded = name in LOADABLE and name != NO_LINKS
        lines.append(f"| `{name}` | {LOADABLE[name] if loaded else '-'} | {notes(name)} |")
    return "\n".join(line.replace("|  |", "| |") for line in lines) + "\n"


def test_the_table_is_what_loads() -> None:
    assert table() in PAGE.read_text(encoding="utf-8"), f"the table should be\n{table()}"


def test_the_counts_are_right() -> None:
    loaded = len(LOADABLE) - 1
    whole = f"{loaded} of the {len(LOADABLE) + len(NOT_LOADABLE)} URDFs"
    assert whole in PAGE.read_text(encoding="utf-8")
