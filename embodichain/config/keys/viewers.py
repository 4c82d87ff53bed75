"""The names of viewers, for `viewer.name`: `VIEWERS`.

A viewer is registered where it is defined, see `embodichain.recording.viewers.showing`, and
imported when a run uses it: here it is a name.
"""

from __future__ import annotations

from typing import Any

from embodichain.utils.register import Register

__all__ = ["NO_VIEWER", "VIEWERS"]

NO_VIEWER = "none"
VIEWERS: Register[Any] = Register(
    "viewer",
    group="embodichain.viewers",
    modules=("embodichain.recording.viewers.kinds.*",),
)
"""``viewer.name`` -> `showing.Viewer`; modules and entry points are called as the viewers."""
