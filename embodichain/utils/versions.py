"""`installed_versions`: the versions of everything that can change a result."""

from __future__ import annotations

import contextlib
import importlib.metadata
import platform

__all__ = ["installed_versions"]

_PACKAGES = (
    "embodichain",
    "mujoco",
    "numpy",
    "torch",
    "tensordict",
    "gymnasium",
    "stable-baselines3",
    "hydra-core",
    "omegaconf",
    "pydantic",
    "mcap",
    "protobuf",
)


def installed_versions() -> dict[str, str | None]:
    """Return versions of packages (None: not installed), of Python, and the platform."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for package in _PACKAGES:
        found[package] = None
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[package] = importlib.metadata.version(package)
    return found | {"platform": platform.platform(), "machine": platform.machine()}
