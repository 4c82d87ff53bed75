"""The cache of made meshes: one folder an entry, named by what it is made from.

An entry is written beside its place and renamed into it, so that it is there whole or not at all,
whoever else makes the same one at the same time.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

__all__ = ["cache_folder", "digest", "entry"]

_MANIFEST = "manifest.json"


def cache_folder() -> Path:
    """Return where made meshes are kept; it need not exist.

    It is ``meshes`` in ``$EMBODICHAIN_CACHE``, else in ``$XDG_CACHE_HOME/embodichain``, else in
    ``~/.cache/embodichain``.
    """
    own = os.environ.get("EMBODICHAIN_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return (Path(own) if own else Path(base, "embodichain")).expanduser() / "meshes"


def digest(recipe: str, files: list[Path]) -> str:
    """Return the name of what a recipe makes of files: 32 hexadecimal digits of their SHA-256.

    Args:
        recipe: How it is made; another version of that has another text.
        files: What it is made from, the main file first. One that is missing counts as such.
    """
    total = sha256(recipe.encode())
    for path in files:
        try:
            total.update(sha256(path.read_bytes()).digest())
        except OSError:
            total.update(b"missing")
    return total.hexdigest()[:32]


def entry(name: str, make: Callable[[Path], dict[str, Any]]) -> tuple[Path, dict[str, Any]]:
    """Return an entry's folder and manifest; it is made if it is not there.

    Args:
        name: From `digest`.
        make: Writes the entry's files into an empty folder and returns its manifest, which JSON can
            hold. What it raises leaves nothing behind.

    Raises:
        OSError: If the cache cannot be written.
    """
    place = cache_folder() / name
    try:
        return place, json.loads((place / _MANIFEST).read_bytes())
    except FileNotFoundError:
        pass
    place.parent.mkdir(parents=True, exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=".making-", dir=place.parent))
    try:
        manifest = make(stage)
        (stage / _MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")
        try:
            stage.rename(place)
        except OSError:
            if not (place / _MANIFEST).is_file():
                raise
            # Another process was first, with the same content.
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return place, manifest
