"""MuJoCo's own timers (`mjData.timer`), off: its Python package starts them, and they cost.

Every stage of a physics step asks for the time twice, together about 1 us a step. Nobody reads
that here, and Python has no call that stops it: the package takes no callback for its own one.
"""

from __future__ import annotations

import ctypes

import mujoco
from mujoco import _callbacks

__all__ = ["stop_timers"]


def stop_timers() -> None:
    """Stop MuJoCo's timers in this process; a callback that someone else installed stays.

    ``mujoco.set_mjcb_time(None)`` starts them again. Where the library's ``mjcb_time`` cannot be
    found (Windows), they run on: slower, and all else the same.
    """
    if mujoco.get_mjcb_time() is not None:
        return
    try:
        # The package's own module: what it was linked with is what is in use, wherever it lies.
        callback = ctypes.c_void_p.in_dll(ctypes.CDLL(_callbacks.__file__), "mjcb_time")
    except (OSError, ValueError):
        return
    callback.value = None
