"""Attachments of a log, with which it can be read and replayed without other files.

Writes and reads the model, the scene, the config, and versions of the recording machine.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
import zstandard

from embodichain.config.run_folder import versions
from embodichain.lab.sim.engine.fields import row_layout
from embodichain.recording.format.container.archive import load_mjz, scene_archive
from embodichain.recording.format.container.unpacking import unpack_zip, unpack_zstd
from embodichain.recording.format.header import Header
from embodichain.recording.format.log_error import DamageError, LogError
from embodichain.recording.format.seals import digest_of

__all__ = [
    "MODEL",
    "SCENE",
    "VARIED",
    "Attachment",
    "approximate_model",
    "attachments_of",
    "check_rows",
    "cpu_name",
    "exact_model",
    "load_mjb",
    "model_bytes",
    "model_digest",
    "model_to_simulate",
    "scene_files",
    "unpack_model",
    "what_differs",
]

Attachment = tuple[str, str, bytes]
"""Name, media type and content."""

MODEL = "model.mjb.zst"
"""Name of the attachment with the compiled model, compressed by zstd."""
SCENE = "scene.mjz"
"""Name of the attachment with the scene's XML and its files, an archive."""
VARIED = "varied.yaml"
"""Name of the attachment with the key paths that variations have set; only where they have."""

_EXPORTED = {"qpos", "qvel", "mocap_pos", "mocap_quat", "ctrl"}
"""Components that are drawn or exported, or have column names from the model."""
_MACHINE = {"cpu": "processor", "platform": "platform"}
"""Entries of versions.json, besides MuJoCo's, on which the bits of physics may depend."""


def model_bytes(model: mujoco.MjModel) -> bytes:
    """The compiled model in MuJoCo's binary format, which is exact."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def model_digest(mjb: bytes) -> str:
    """Digest that identifies a model in the log's metadata."""
    return digest_of(mjb)


def unpack_model(data: bytes, header: Header | None = None) -> bytes:
    """Decompress the attachment `MODEL` to the bytes of `model_bytes`.

    Args:
        data: The attachment.
        header: The log's metadata, which states the size; None if it is not known.

    Raises:
        LogError: If it is damaged, or larger than stated, or than it may be.
    """
    try:
        return unpack_zstd(data, _stated(header, MODEL))
    except DamageError as error:
        raise LogError(f"the attachment {MODEL} is damaged: {error}") from error


def _stated(header: Header | None, name: str) -> int | None:
    """The size to which an attachment unpacks, as the metadata state it; None if they do not."""
    if header is None or name not in header.attachments:
        return None
    size, _ = header.attachments[name]
    return size


def load_mjb(data: bytes) -> mujoco.MjModel:
    """Load a model from the bytes of `model_bytes`.

    Raises:
        ValueError: If this version of MuJoCo cannot read it.
    """
    return mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": data})


def cpu_name() -> str:
    """Name of this machine's processor, if it is known."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    for line in lines:
        if line.startswith("model name"):
            name = line.split(":", 1)[1].strip()
            if name:
                return name
            break
    return platform.processor() or platform.machine()


def attachments_of(
    mjb: bytes,
    spec: mujoco.MjSpec | None,
    config: str,
    overrides: str | Sequence[str],
    layout: Mapping[str, Any],
    varied: Collection[str] = (),
) -> list[Attachment]:
    """Every attachment of a log.

    Args:
        mjb: The model, from `model_bytes`.
        spec: The scene, if it is known.
        config: The resolved config as YAML text.
        overrides: Overrides of the command line, a list or YAML text.
        layout: The viewers' layout.
        varied: Key paths of the config that variations have set.
    """
    if not isinstance(overrides, str):
        overrides = yaml.safe_dump(list(overrides), allow_unicode=True)
    installed = {name: version or "not installed" for name, version in versions().items()}
    installed["cpu"] = cpu_name()
    attachments: list[Attachment] = [
        (MODEL, "application/zstd", zstandard.ZstdCompressor(level=3).compress(mjb)),
        ("config.yaml", "application/yaml", config.encode()),
        ("overrides.yaml", "application/yaml", overrides.encode()),
        ("foxglove_layout.json", "application/json", json.dumps(layout, indent=1).encode()),
        (
            "versions.json",
            "application/json",
            json.dumps(installed, indent=1).encode(),
        ),
    ]
    if spec is not None:
        attachments.insert(1, (SCENE, "application/zip", scene_archive(spec)))
    if varied:
        paths = yaml.safe_dump(sorted(varied), allow_unicode=True)
        attachments.append((VARIED, "application/yaml", paths.encode()))
    return attachments


def exact_model(header: Header, packed: bytes) -> mujoco.MjModel:
    """The exact recorded model; needs the same version of MuJoCo.

    Args:
        header: The log's metadata.
        packed: Its attachment `MODEL`.

    Raises:
        LogError: If its digest is wrong, or this version of MuJoCo cannot read it.
    """
    mjb = unpack_model(packed, header)
    if model_digest(mjb) != header.model:
        raise LogError(f"the attachment {MODEL} is not the model that was recorded")
    try:
        model = load_mjb(mjb)
    except ValueError as error:
        raise LogError(f"the attachment {MODEL} cannot be loaded: {error}") from error
    check_rows(header, model)
    return model


def model_to_simulate(header: Header, attachment: Callable[[str], bytes]) -> mujoco.MjModel:
    """The model for exact simulation of a log; `attachment` returns an attachment by name.

    Raises:
        LogError: If this version of MuJoCo cannot simulate it exactly, or the model is damaged.
    """
    if header.mujoco_version != mujoco.__version__:
        raise LogError(f"need mujoco=={header.mujoco_version}, this is {mujoco.__version__}")
    return exact_model(header, attachment(MODEL))


def approximate_model(header: Header, mjz: bytes) -> mujoco.MjModel:
    """The model compiled from the scene's XML (six digits), for other versions of MuJoCo.

    Args:
        header: The log's metadata.
        mjz: Its attachment scene.mjz.

    Raises:
        LogError: If it cannot be compiled, or a component of its state has another size.
            Components that only one version has do not matter for reading; `check_rows` checks
            them.
    """
    try:
        model = load_mjz(mjz, _stated(header, SCENE))
    except ValueError as error:
        raise LogError(f"the attachment scene.mjz cannot be loaded: {error}") from error
    layout = row_layout(model)
    recorded_layout = header.slices()
    for name in layout.keys() & recorded_layout.keys() & _EXPORTED:
        size = layout[name].stop - layout[name].start
        recorded_size = recorded_layout[name].stop - recorded_layout[name].start
        if size != recorded_size:
            raise LogError(f"rows have {recorded_size} numbers of {name!r}, the model has {size}")
    return model


def scene_files(header: Header, mjz: bytes) -> dict[str, bytes]:
    """The files of the attachment `SCENE` by name: the XML, meshes and textures.

    Raises:
        LogError: If it is damaged, or larger than the metadata state.
    """
    try:
        return unpack_zip(mjz, _stated(header, SCENE))
    except DamageError as error:
        raise LogError(f"the attachment {SCENE} is damaged: {error}") from error


def check_rows(header: Header, model: mujoco.MjModel) -> None:
    """Check that a log's rows have the same columns as a model's state.

    Raises:
        LogError: If they do not.
    """
    size = mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_INTEGRATION))
    if size != header.nstate:
        raise LogError(f"the model has {size} numbers of state, the rows have {header.nstate}")
    here = row_layout(model)
    for name, columns in header.slices().items():
        if name not in here or here[name] != columns:
            recorded = f"columns {columns.start} to {columns.stop} of rows"
            raise LogError(f"the metadata says that {name!r} is {recorded}, the model does not")


def what_differs(header: Header, versions: bytes | None) -> list[str]:
    """Differences to the recording machine on which the bits of physics may depend, a line each.

    Args:
        header: The log's metadata.
        versions: Its attachment versions.json, if it has one.
    """
    differences = []
    if header.mujoco_version != mujoco.__version__:
        differences.append(f"MuJoCo {header.mujoco_version} there, {mujoco.__version__} here")
    try:
        recorded = json.loads(versions or b"{}")
    except ValueError:
        recorded = {}
    if not isinstance(recorded, dict):
        return differences
    here = {"cpu": cpu_name(), "platform": platform.platform()}
    for key, label in _MACHINE.items():
        value = recorded.get(key)
        if isinstance(value, str) and value != here[key]:
            differences.append(f"{label} {value} there, {here[key]} here")
    return differences
