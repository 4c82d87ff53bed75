"""What the HDF5 formats share: robomimic's attributes, and models with their files."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from embodichain.config.robomimic_env import ENV_NAME
from embodichain.recording.export.format_register import required
from embodichain.recording.export.meaning import action_names, describe_action, instruction_of
from embodichain.recording.format.attachments import SCENE, scene_files
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.recorded_log import RecordedLog

__all__ = ["ModelFiles", "describe_root", "new_hdf5", "say_action", "say_task"]

_GYM_TYPE = 2  # robomimic's EnvType.GYM_TYPE
_MODEL = "model.xml"
ASSETS = "assets"
"""Group with the files that models name, each an array of bytes."""
_HOW = (
    "mujoco.MjModel.from_xml_string(demo.attrs['model_file'], "
    "{path: file['assets'][path][()].tobytes() for path in demo.attrs['model_assets']})"
)


@contextmanager
def new_hdf5(path: Path, format: str) -> Iterator[tuple[Any, Callable[[], None]]]:
    """Open a new file, in the version of HDF5 from 1.8 on, whose attributes may exceed 64 KB.

    Yields the file, and a function to call now and then, which raises the `OSError` if the file
    cannot be written any more; so does the end of the context.

    Raises:
        ConfigError: If h5py is not installed.
        OSError: If the file cannot be written.
    """
    h5py: Any = required("h5py", format)
    with _Stream(path) as stream:
        try:
            with h5py.File(stream, "w", libver=("v108", "latest")) as file:
                yield file, stream.check
        finally:  # instead of what HDF5 makes of it
            stream.check()


class _Stream(io.FileIO):
    """A new file for HDF5, which hears of no failure.

    HDF5 frees what it could not write, and frees it again when it is closed: a disk that is full
    would end the process. Here it goes on; the first failure is kept, and nothing written any more.
    Nor is anything written after it is closed: a signal in the middle of opening leaves HDF5 with
    an open file, which it writes when the last reference to it is gone.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "x+")
        self._error: OSError | None = None

    def check(self) -> None:
        """Raise the first failure, if there was one."""
        if self._error is not None:
            raise self._error

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Go to a place, unless the file is closed."""
        return 0 if self.closed else super().seek(offset, whence)

    def write(self, data: Any) -> int:
        """Write all bytes, unless there was a failure."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left and self._error is None and not self.closed:
                done = super().write(left)  # writes less if the disk is nearly full
                left = left[done:]
        except OSError as error:
            self._error = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the size of the file, unless there was a failure."""
        try:
            if self._error is None and not self.closed:
                return super().truncate(size)
        except OSError as error:
            self._error = error
        return size or 0

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""


def describe_root(root: Any, log: RecordedLog) -> None:
    """Say in the group ``data`` which environment this is, and how often actions are given."""
    action = describe_action(log)
    args = {
        "env_name": ENV_NAME,
        "type": _GYM_TYPE,
        "env_kwargs": {"name": log.task, "config": log.written_config},
        "control_freq": action["rate_hz"],
        "action": action,
        "lang": instruction_of(log),
    }
    root.attrs["env_args"] = json.dumps(args)
    root.attrs["action"] = json.dumps(action)
    root.attrs["model_how"] = _HOW


def say_task(demo: Any, log: RecordedLog) -> None:
    """Say what a demonstration was to do, where robomimic looks for its language."""
    instruction = instruction_of(log)
    demo.attrs["ep_meta"] = json.dumps({"lang": instruction})
    demo.attrs["instruction"] = instruction


def say_action(actions: Any, log: RecordedLog) -> None:
    """Name the columns of the array ``actions``; the meaning of each is an array too."""
    actions.attrs["names"] = action_names(log, actions.shape[1])
    columns = log.header.action
    if len(columns) != actions.shape[1] or not columns:
        return
    for key in ("quantity", "mode", "reference", "frame", "unit"):
        actions.attrs[key] = [column[key] for column in columns]
    for key in ("centre", "scale", "low", "high"):
        actions.attrs[key] = np.array([_number(column[key]) for column in columns])
    actions.attrs["rate_hz"] = describe_action(log)["rate_hz"]


def _number(value: float | str) -> float:
    """A number; NaN where words stand for it, which are in the attribute ``action`` of ``data``."""
    return float("nan") if isinstance(value, str) else float(value)


class ModelFiles:
    """Models of logs, with their meshes and pictures kept once in a data set.

    Args:
        file: The HDF5 file.
    """

    def __init__(self, file: Any) -> None:
        self._file = file
        self._kept: dict[bytes, str] = {}
        self._models: dict[Path, tuple[str, list[str]]] = {}

    def add(self, demo: Any, log: RecordedLog) -> None:
        """Set ``model_file`` and ``model_assets`` of a demonstration.

        Raises:
            LogError: If the log has no scene, or it is damaged.
        """
        if log.path not in self._models:
            self._models = {log.path: self._store(log)}
        xml, paths = self._models[log.path]
        demo.attrs["model_file"] = xml
        demo.attrs["model_assets"] = paths if paths else np.zeros(0, "S1")

    def _store(self, log: RecordedLog) -> tuple[str, list[str]]:
        files = scene_files(log.header, log.attachment(SCENE))
        try:
            xml = files.pop(_MODEL).decode()
        except (KeyError, UnicodeDecodeError) as error:
            raise LogError(f"{log.path}: the attachment {SCENE} is damaged: {error!r}") from error
        used = []
        for name, data in files.items():
            kept = self._kept.get(data)
            if kept is None:
                kept = f"{len(self._kept):03d}_{name.rpartition('/')[2]}"
                self._kept[data] = kept
                self._file.create_dataset(
                    f"{ASSETS}/{kept}", data=np.frombuffer(data, np.uint8), compression="gzip"
                )
            xml = xml.replace(f'"{name}"', f'"{kept}"')
            used.append(kept)
        return xml, used
