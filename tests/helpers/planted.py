"""Payloads that leave a trace when somebody runs them, planted into files of other people."""

import base64
import json
import os
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import cloudpickle  # type: ignore[import-untyped]

TRACE = "PWNED"
"""The file that a payload makes in the working directory."""
NAME = f"{os.system.__module__}.system"
"""What a pickle with a `Payload` names: ``posix.system``."""


class Payload:
    """Its pickle makes the trace."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {TRACE}",)


def was_run() -> bool:
    """Whether a payload was run in the working directory; forgets it."""
    found = Path(TRACE).exists()
    Path(TRACE).unlink(missing_ok=True)
    return found


def pickled(value: Any) -> bytes:
    """A pickle, of classes of tests by their names."""
    data: bytes = cloudpickle.dumps(value)
    return data


def replace(path: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a zip, in place of those of the same names."""
    with zipfile.ZipFile(path) as archive:
        kept = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in {**kept, **files}.items():
            archive.writestr(name, data)


def plant(path: Path, attributes: Iterable[str], value: Any = None) -> None:
    """Put a payload into attributes of a zip of Stable-Baselines3, as that pickles them."""
    with zipfile.ZipFile(path) as archive:
        data = json.loads(archive.read("data"))
    text = base64.b64encode(pickled(Payload() if value is None else value)).decode()
    data |= {name: {":type:": "<class 'x'>", ":serialized:": text} for name in attributes}
    replace(path, {"data": json.dumps(data).encode()})
