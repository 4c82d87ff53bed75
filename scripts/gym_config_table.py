"""Writes into docs/compatibility.md what of EmbodiChain's own configs is left out, and why.

`python scripts/gym_config_table.py`: the tables of `compat.gym_config`, between two marks.
"""

from __future__ import annotations

from pathlib import Path

from embodichain.compat.gym_config.functors import left_out_functors
from embodichain.compat.gym_config.vocabulary import left_out

PAGE = Path(__file__).parents[1] / "docs" / "compatibility.md"
BEGIN, END = "<!-- left out: begin -->\n", "<!-- left out: end -->\n"


def table() -> str:
    """Return the rows, keys of a section with the same reason in one."""
    rows: dict[tuple[str, str], list[str]] = {}
    for item in left_out():
        rows.setdefault((f"`{item.section}`" if item.section else "top", item.reason), []).append(
            f"`{item.key}`"
        )
    for item in left_out_functors():
        rows.setdefault((item.section, item.reason), []).append(f"`{item.key}`")
    lines = [f"| {where} | {', '.join(keys)} | {why} |" for (where, why), keys in rows.items()]
    return "\n".join(["| where | what | why |", "| --- | --- | --- |", *lines]) + "\n"


def filled(text: str) -> str:
    """Return a page with the table between the marks."""
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}{table()}{END}{tail}"


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
