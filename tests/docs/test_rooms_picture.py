"""The picture of the rooms: what import-linter holds, and what lies in the folders."""

from pathlib import Path

import pytest

from scripts import rooms

REPO = Path(__file__).parents[2]


def test_the_picture_is_that_of_the_contracts() -> None:
    assert rooms.PICTURE.read_text(encoding="utf-8") == rooms.picture(), "python scripts/rooms.py"


def test_another_layer_is_another_picture(tmp_path: Path) -> None:
    text = (REPO / "pyproject.toml").read_text(encoding="utf-8")
    assert '"cli", "tasks", ' in text
    (tmp_path / "pyproject.toml").write_text(text.replace('"cli", "tasks", ', '"tasks", "cli", '))
    assert rooms.contracts(tmp_path)["embodichain"][:2] == [["tasks"], ["cli"]]
    assert rooms.picture(tmp_path) != rooms.picture()


@pytest.mark.parametrize("package", sorted(rooms.contracts()))
def test_every_name_of_a_panel_is_a_file_or_a_folder(package: str) -> None:
    folder = REPO / package.replace(".", "/")
    names = [name for layer in rooms.contracts()[package] for name in layer]
    assert [n for n in names if not any((folder / f).exists() for f in (n, f"{n}.py"))] == []
