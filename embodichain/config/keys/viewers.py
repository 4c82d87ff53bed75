"""The names of viewers, for `viewer.name`: `VIEWERS`.

A viewer is registered where it is defined, see `embodichain.recording.viewers.showing`, and
imported when a run uses it: here it is a name.
"""

from __future__ import annotations

from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from embodichain.utils.register import Register

__all__ = ["NO_VIEWER", "VIEWERS", "ViewerNames"]

NO_VIEWER = "none"
VIEWERS: Register[Any] = Register(
    "viewer",
    group="embodichain.viewers",
    modules=("embodichain.recording.viewers.kinds.*",),
)
"""``viewer.name`` -> `showing.Viewer`; modules and entry points are called as the viewers."""


class ViewerNames:
    """Tells pydantic the names of viewers, when it first builds a schema with them."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.literal_schema([NO_VIEWER, *VIEWERS.names()])
