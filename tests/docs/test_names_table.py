"""The tables of EmbodiChain's names in docs/compatibility.md are those of the code."""

from scripts.names_table import PAGE, filled


def test_tables_are_up_to_date() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text == filled(text), "python scripts/names_table.py writes it"
