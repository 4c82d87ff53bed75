"""Digests of files, and of the code that computes results."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import embodichain

__all__ = ["code_digest", "file_digest", "modules_in"]

_IMPORT_PATH = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@cache
def code_digest(modules: tuple[str, ...] = ()) -> str:
    """Return the SHA-256 of this package's sources and of further modules.

    Args:
        modules: Names of modules; those that cannot be found are left out.
    """
    total = hashlib.sha256()
    for name, path in sorted(_sources()):
        total.update(name.encode())
        total.update(path.read_bytes())
    for module in modules:
        spec = importlib.util.find_spec(module)
        if spec is not None and spec.origin is not None and Path(spec.origin).is_file():
            total.update(Path(spec.origin).read_bytes())
    return total.hexdigest()


def _sources() -> Iterator[tuple[str, Path]]:
    """Yield name and path of each module of this package; in a checkout some folders are links."""
    root = Path(embodichain.__file__).parent
    for folder, _, names in os.walk(root, followlinks=True):
        for name in names:
            path = Path(folder, name)
            if path.suffix == ".py":
                yield path.relative_to(root).as_posix(), path


def modules_in(value: Any) -> Iterator[str]:
    """Yield the modules of all ``package.module:function`` in a config."""
    if isinstance(value, Mapping):
        for item in value.values():
            yield from modules_in(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from modules_in(item)
    elif isinstance(value, str) and _IMPORT_PATH.fullmatch(value):
        yield value.partition(":")[0]
