"""The table of docs/robots.md is the catalogue that the compiler's tests go by."""

from pathlib import Path

from tests.data.robot_catalog import (
    COLOUR,
    EMPTY,
    INERTIA,
    LOADABLE,
    NOT_LOADABLE,
    REPAIRED,
    SHELL,
    STL,
)

PAGE = Path(__file__).parents[2] / "docs" / "robots.md"
WORDS = {
    INERTIA: "masses or inertias are repaired",
    SHELL: "a mesh without volume is taken as a shell",
    COLOUR: "the file lacks the colour of a part of its feet",
    STL: "an ASCII STL is converted",
    EMPTY: "joints whose limits are equal move without limits",
}
REASONS = {
    "mesh files are missing": "20 of its mesh files are missing",
    "the robot has no <link>": "it has no links",
}


def notes(name: str) -> str:
    if name in NOT_LOADABLE:
        return f"**not loaded**: {REASONS[NOT_LOADABLE[name]]}"
    return "; ".join(WORDS[said] for said in REPAIRED.get(name, ()))


def table() -> str:
    lines = ["| robot | joints | |", "| --- | --- | --- |"]
    for name in sorted([*LOADABLE, *NOT_LOADABLE]):
        lines.append(f"| `{name}` | {LOADABLE.get(name, '-')} | {notes(name)} |")
    return "\n".join(line.replace("|  |", "| |") for line in lines) + "\n"


def test_the_table_is_what_loads() -> None:
    assert table() in PAGE.read_text(encoding="utf-8"), f"the table should be\n{table()}"


def test_the_counts_are_right() -> None:
    whole = f"{len(LOADABLE)} of the {len(LOADABLE) + len(NOT_LOADABLE)} URDFs"
    assert whole in PAGE.read_text(encoding="utf-8")
