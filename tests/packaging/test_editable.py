"""Other ways to import: `pip install -e .` (type checkers find the package), a zip (refused)."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
BUILD = "import sys, setuptools.build_meta as b; b.build_editable(sys.argv[1])"


def test_an_editable_install_is_a_path_that_type_checkers_follow(tmp_path):
    """Mypy and pyright read paths from `.pth` files; they cannot follow an import hook."""
    done = subprocess.run(
        [sys.executable, "-c", BUILD, str(tmp_path)], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        paths = [name for name in archive.namelist() if name.endswith(".pth")]
        lines = [archive.read(name).decode().strip() for name in paths]
        assert not [name for name in archive.namelist() if name.endswith(".py")]
    assert lines == [str(ROOT)]
    assert (ROOT / "embodichain" / "py.typed").is_file()


def test_an_import_from_a_zip_is_one_sentence(tmp_path):
    archive = tmp_path / "packages.zip"
    with zipfile.ZipFile(archive, "w") as packed:
        for path in (ROOT / "embodichain").rglob("*.py"):
            packed.write(path, path.relative_to(ROOT))
    code = f"import sys; sys.path.insert(0, {str(archive)!r}); import embodichain"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 1
    said = done.stderr.splitlines()[-1]
    assert said.startswith(
        f"ImportError: embodichain cannot be imported from an archive ({archive})"
    )
    assert "Install it with pip, or unpack the archive" in said
