"""What the HDF5 formats share: robomimic's attributes, and models with their files."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from embodichain.config.robomimic_env import ENV_NAME
from embodichain.recording.export.format_register import required
from embodichain.recording.export.meaning import action_names, describe_action, instruction_of
from embodichain.recording.format.attachments import SCENE, scene_files
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.recorded_log import RecordedLog

__all__ = [
    "ModelFiles",
    "describe_root",
    "new_hdf5",
    "write_action_attributes",
    "write_instruction",
]

_GYM_TYPE = 2  # robomimic's EnvType.GYM_TYPE
_MODEL = "model.xml"
ASSETS = "assets"
"""Group with the files that models name, each an array of bytes."""
_HOW_TO_COMPILE = (
    "mujoco.MjModel.from_xml_string(demo.attrs['model_file'], "
    "{path: file['assets'][path][()].tobytes() for path in demo.attrs['model_assets']})"
)


@contextmanager
def new_hdf5(path: Path, format: str) -> Iterator[tuple[Any, Callable[[], None]]]:
    """Open a new file, in the version of HDF5 from 1.8 on, whose attributes may exceed 64 KB.

    Yields:
        The file, and a function to call now and then, which raises the `OSError` if the file cannot
        be written any more; so does the end of the context.

    Raises:
        ConfigError: If h5py is not installed.
        OSError: If the file cannot be written.
    """
    h5py: Any = required("h5py", format)
    with _Stream(path) as stream:
        try:
            with h5py.File(stream, "w", libver=("v108", "latest")) as file:
                yield file, stream.check
        finally:  # this error says why; those that HDF5 raises after it do not
            stream.check()


class _Stream(io.FileIO):
    """A new file for HDF5, which is not told of failures.

    HDF5 frees what it could not write, and frees it again when the file is closed: a full disk
    would end the process. So writing seems to succeed: the first failure is stored for `check`,
    and nothing is written after it. Nothing is written after the file is closed either: a signal
    in the middle of opening leaves HDF5 with an open file, which it writes when the last reference
    to it is gone.

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
        if self.closed:
            return 0
        return super().seek(offset, whence)

    def write(self, data: Any) -> int:
        """Write all bytes, unless there was a failure."""
        remaining = memoryview(data).cast("B")
        size = len(remaining)
        try:
            while remaining and self._error is None and not self.closed:
                written = super().write(remaining)  # writes less if the disk is nearly full
                remaining = remaining[written:]
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
    """Describe in the group ``data`` the environment, and how often actions are given."""
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
    root.attrs["model_how"] = _HOW_TO_COMPILE


def write_instruction(demo: Any, log: RecordedLog) -> None:
    """Write the task's sentence into a demonstration, where robomimic looks for its language."""
    instruction = instruction_of(log)
    demo.attrs["ep_meta"] = json.dumps({"lang": instruction})
    demo.attrs["instruction"] = instruction


def write_drawn(demo: Any, drawn: Mapping[str, Sequence[float]]) -> None:
    """Write what was drawn for an episode: attributes of the group ``drawn``, one for each draw.

    Without draws there is no group.
    """
    if not drawn:
        return
    group = demo.create_group("drawn")
    for name, numbers in drawn.items():
        group.attrs[name] = np.array(numbers, np.float64)


def write_action_attributes(actions: Any, log: RecordedLog) -> None:
    """Write attributes of the array ``actions``: names and meaning of its columns."""
    width = actions.shape[1]
    actions.attrs["names"] = action_names(log, width)
    columns = log.header.action
    if len(columns) != width or not columns:
        return
    for key in ("quantity", "mode", "reference", "frame", "unit"):
        actions.attrs[key] = [column[key] for column in columns]
    for key in ("centre", "scale", "low", "high"):
        actions.attrs[key] = np.array([_number(column[key]) for column in columns])
    actions.attrs["rate_hz"] = describe_action(log)["rate_hz"]


def _number(value: float | str) -> float:
    """Return a number; NaN for words, which are in the attribute ``action`` of ``data``."""
    if isinstance(value, str):
        return float("nan")
    return float(value)


class _Model(NamedTuple):
    """The model of a log, as demonstrations refer to it.

    Attributes:
        xml: The MJCF, which names its files as the group `ASSETS` does.
        assets: Names of the files.
    """

    xml: str
    assets: list[str]


class ModelFiles:
    """Models of logs, whose meshes and pictures are in a data set only once.

    Args:
        file: The HDF5 file.
    """

    def __init__(self, file: Any) -> None:
        self._file = file
        self._asset_names: dict[bytes, str] = {}
        # Of the last log only: demonstrations of a log follow one another.
        self._models: dict[Path, _Model] = {}

    def add(self, demo: Any, log: RecordedLog) -> None:
        """Set ``model_file`` and ``model_assets`` of a demonstration.

        Raises:
            LogError: If the log has no scene, or it is damaged.
        """
        if log.path not in self._models:
            self._models = {log.path: self._store(log)}
        model = self._models[log.path]
        demo.attrs["model_file"] = model.xml
        # HDF5 has no type for an empty list.
        demo.attrs["model_assets"] = model.assets if model.assets else np.zeros(0, "S1")

    def _store(self, log: RecordedLog) -> _Model:
        """Write the files of a log's model that the data set does not have yet."""
        files = scene_files(log.header, log.attachment(SCENE))
        try:
            xml = files.pop(_MODEL).decode()
        except (KeyError, UnicodeDecodeError) as error:
            raise LogError(f"{log.path}: the attachment {SCENE} is damaged: {error!r}") from error
        assets = []
        for path, data in files.items():
            name = self._asset_names.get(data)
            if name is None:
                name = f"{len(self._asset_names):03d}_{path.rpartition('/')[2]}"
                self._asset_names[data] = name
                self._file.create_dataset(
                    f"{ASSETS}/{name}", data=np.frombuffer(data, np.uint8), compression="gzip"
                )
            xml = xml.replace(f'"{path}"', f'"{name}"')
            assets.append(name)
        return _Model(xml, assets)
