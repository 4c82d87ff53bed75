"""Settings of MuJoCo for the whole process: warnings go to logging, timers are off, threads."""

from __future__ import annotations

import ctypes
import logging
import os

import mujoco
from mujoco import _callbacks

__all__ = ["all_cores", "install_log_handler", "stop_timers"]

_logger = logging.getLogger("embodichain.mujoco")


def install_log_handler() -> None:
    """Send MuJoCo's warnings to the logger ``embodichain.mujoco``, at level INFO.

    MuJoCo would write them to MUJOCO_LOG.TXT in the working directory. The level is INFO because
    `info` and the log report divergence already. A handler set by the user is kept.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_log)


def _log(message: str | bytes) -> None:
    text = message.decode(errors="replace") if isinstance(message, bytes) else message
    _logger.info("%s", text)


def stop_timers() -> None:
    """Stop MuJoCo's timers (`mjData.timer`) in this process; a user's time callback is kept.

    MuJoCo's Python package starts them, and every stage of a physics step reads the clock twice,
    about 1 us per step in total. Python has no call that stops them; ``mujoco.set_mjcb_time(None)``
    restarts them. Where the library's ``mjcb_time`` cannot be found (Windows), they keep running.
    """
    if mujoco.get_mjcb_time() is not None:
        return
    try:
        # The library that the package is linked with, wherever it is installed.
        callback = ctypes.c_void_p.in_dll(ctypes.CDLL(_callbacks.__file__), "mjcb_time")
    except (OSError, ValueError):
        return
    callback.value = None


def all_cores() -> int:
    """Return how many cores this process may use; on systems without affinity, all there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
