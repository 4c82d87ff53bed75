"""What a log carries beside its messages, so that it can be read and replayed alone."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from hashlib import blake2b
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import mujoco
import numpy as np
import yaml
import zstandard

from embodichain.recording.archive import scene_archive
from embodichain.recording.log_error import LogError
from embodichain.recording.provenance import cpu_name

__all__ = [
    "MODEL",
    "Attachment",
    "attachments_of",
    "load_mjb",
    "model_bytes",
    "model_digest",
    "overrides_yaml",
    "unpack_model",
    "versions",
]

Attachment = tuple[str, str, bytes]
"""Name, media type and content."""

MODEL = "model.mjb.zst"
"""Attachment with the compiled model, compressed by zstd."""
_LARGEST_MODEL = 2**31
"""Bytes; a larger model is not unpacked."""

_PACKAGES = (
    "embodichain",
    "gymnasium",
    "mcap",
    "mujoco",
    "numpy",
    "stable-baselines3",
    "torch",
)


def model_bytes(model: mujoco.MjModel) -> bytes:
    """The compiled model in MuJoCo's binary format, exact to the bit."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def model_digest(mjb: bytes) -> str:
    """Names a model in the log's metadata."""
    return blake2b(mjb, digest_size=16).hexdigest()


def unpack_model(data: bytes) -> bytes:
    """What `model_bytes` made, out of the attachment `MODEL`.

    Raises:
        LogError: If it is damaged, or too large.
    """
    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= _LARGEST_MODEL:
            raise LogError(f"the attachment {MODEL} says it has {size} bytes")
        return zstandard.ZstdDecompressor().decompress(data)
    except zstandard.ZstdError as error:
        raise LogError(f"the attachment {MODEL} is damaged: {error}") from error


def load_mjb(data: bytes) -> mujoco.MjModel:
    """Load what `model_bytes` made.

    Raises:
        ValueError: If this MuJoCo does not read it.
    """
    return mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": data})


def versions() -> dict[str, str]:
    """Versions of what decides a run's bytes, and the processor."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    found["cpu"] = cpu_name()
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def overrides_yaml(overrides: str | Sequence[str]) -> str:
    """Command-line overrides as a YAML list; text is taken as it is."""
    if isinstance(overrides, str):
        return overrides
    return yaml.safe_dump(list(overrides), allow_unicode=True)


def attachments_of(
    mjb: bytes,
    spec: mujoco.MjSpec | None,
    config: str,
    overrides: str | Sequence[str],
    layout: Mapping[str, Any],
) -> list[Attachment]:
    """Every attachment of a log."""
    attachments: list[Attachment] = [
        (MODEL, "application/zstd", zstandard.ZstdCompressor(level=3).compress(mjb)),
        ("config.yaml", "application/yaml", config.encode()),
        ("overrides.yaml", "application/yaml", overrides_yaml(overrides).encode()),
        ("foxglove_layout.json", "application/json", json.dumps(layout, indent=1).encode()),
        ("versions.json", "application/json", json.dumps(versions(), indent=1).encode()),
    ]
    if spec is not None:
        attachments.insert(1, ("scene.mjz", "application/zip", scene_archive(spec)))
    return attachments
