"""docs/terms.md is what is registered, word for word."""

from pathlib import Path

from embodichain.cli import main

PAGE = Path(__file__).parents[2] / "docs" / "terms.md"


def test_the_page_is_what_is_registered(capsys) -> None:
    assert main(["list", "terms", "--markdown"]) == 0
    page = capsys.readouterr().out
    assert PAGE.read_text(encoding="utf-8") == page, (
        "write it anew: embodichain list terms --markdown > docs/terms.md"
    )


def test_the_page_goes_with_terms_only(capsys) -> None:
    assert main(["list", "tasks", "--markdown"]) == 2
    assert "--markdown goes with `list terms`" in capsys.readouterr().err
