"""Where a log was made: what decides how physics rounds, and what is another here."""

from __future__ import annotations

import json
import platform
from pathlib import Path

import mujoco

from embodichain.recording.header import Header

__all__ = ["cpu_name", "what_can_be_played", "what_differs"]

_DECIDES = {"cpu": "processor", "platform": "platform"}
"""Entries of versions.json, beside MuJoCo's, on which bits of physics may depend."""


def cpu_name() -> str:
    """Name of this machine's processor, as far as it tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or platform.machine()


def what_differs(header: Header, versions: bytes | None) -> list[str]:
    """What decides bits of physics and is another here than where the log was made, a line each.

    Args:
        header: The log's metadata.
        versions: Its attachment versions.json, if it has one.
    """
    found = []
    if header.mujoco_version != mujoco.__version__:
        found.append(f"MuJoCo {header.mujoco_version} there, {mujoco.__version__} here")
    try:
        recorded = json.loads(versions or b"{}")
    except ValueError:
        recorded = {}
    here = {"cpu": cpu_name(), "platform": platform.platform()}
    for key, word in _DECIDES.items():
        there = recorded.get(key) if isinstance(recorded, dict) else None
        if isinstance(there, str) and there != here[key]:
            found.append(f"{word} {there} there, {here[key]} here")
    return found


def what_can_be_played(header: Header) -> str:
    """What such a log is still good for where physics is another."""
    if header.keyframe_every and header.mujoco_version != mujoco.__version__:
        what = f"every {header.keyframe_every}th state, which was recorded, can be read"
        return f"{what} (recording.open); those between need mujoco=={header.mujoco_version}"
    return "its recorded states can be played all the same: replay --view, replay --video, export"
