"""MuJoCo's window; needs a display."""

from __future__ import annotations

from embodichain.recording.viewers.operators.native_operator import NativeOperator
from embodichain.recording.viewers.showing import Viewing, viewer

__all__ = ["show_window"]


@viewer("native", controls=True)
def show_window(viewing: Viewing) -> None:
    """Let a person move the robot in the window, which the simulation opens itself."""
    if viewing.teleop is not None:
        viewing.teleop.operator = NativeOperator(viewing.env, viewing.teleop, viewing.stopped)
