"""MuJoCo's window; needs a display."""

from __future__ import annotations

from embodichain.recording.viewers.operators.native_operator import NativeOperator
from embodichain.recording.viewers.showing import Audience, Shown, Viewing, viewer

__all__ = ["show_window"]


@viewer("native", controls=True)
def show_window(viewing: Viewing) -> Shown | None:
    """Let a person move the robot in the window, which the simulation opens itself."""
    sim = viewing.env.sim
    if viewing.teleop is not None:
        viewing.teleop.operator = NativeOperator(viewing.env, viewing.teleop, viewing.stopped)
    if not sim.is_window_open:  # there is no display, which was said
        return None
    audience = Audience(is_watched=lambda: sim.is_window_open, what="the window", may_return=False)
    return Shown(url="", address="", audience=audience)
