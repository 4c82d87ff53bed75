"""What is asked of a folder after a fault: is each file whole that has its final name?"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import yaml

__all__ = ["CUT", "TEMPORARY", "half_written"]

TEMPORARY = " is temporary"
"""How a line ends about a file that a process left."""
CUT = "EndOfFile"
"""How a line ends about a log that is cut."""


def half_written(folder: Path) -> list[str]:
    """What below a folder is a temporary file, or not whole under its final name.

    A log may be cut, since it says so and is read up to there; so may the last line of a list.
    """
    found = []
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if ".part" in path.name and path.name.startswith("."):
            found.append(f"{name}{TEMPORARY}")
        elif path.is_file() and (why := _damage(path)):
            found.append(f"{name}: {why}")
        elif path.is_symlink() and not path.exists():
            found.append(f"{name} links to nothing")
    return found


def _damage(path: Path) -> str:
    check = _CHECKS.get(path.suffix)
    if check is None:
        return ""
    try:
        check(path)
    except Exception as error:  # noqa: BLE001  (any reader's, which is the answer)
        return f"{type(error).__name__}: {error}"[:200]
    return ""


def _zip(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        if archive.testzip() is not None:
            raise ValueError("damaged")


def _page(path: Path) -> None:
    if not path.read_text().rstrip().endswith("</html>"):
        raise ValueError("cut")


def _picture(path: Path) -> None:
    from PIL import Image

    with Image.open(path) as image:
        image.load()


def _log(path: Path) -> None:
    from embodichain.recording.format.log_error import LogError
    from embodichain.recording.read.chunks import LogReader

    if not path.stat().st_size:
        return
    try:
        with LogReader(path) as reader:
            for _ in reader.messages():
                pass
    except LogError:
        if path.name.startswith("recovered"):
            raise


def _config(path: Path) -> None:
    text = path.read_text()
    if text and yaml.safe_load(text) is None:
        raise ValueError("empty")


def _table(path: Path) -> None:
    import pyarrow.parquet as pq

    pq.read_table(path)


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path) as file:
        file.visititems(lambda _, item: item[()] if isinstance(item, h5py.Dataset) else None)


_CHECKS: dict[str, Callable[[Path], object]] = {
    **dict.fromkeys((".zip", ".npz"), _zip),
    **{".json": lambda path: json.loads(path.read_text()), ".yaml": _config, ".html": _page},
    **{".png": _picture, ".mcap": _log, ".parquet": _table, ".hdf5": _hdf5},
}
