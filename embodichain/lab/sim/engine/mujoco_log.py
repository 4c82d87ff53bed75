"""Where MuJoCo's warnings go: Python's logging, never MUJOCO_LOG.TXT in someone's directory."""

from __future__ import annotations

import logging

import mujoco

__all__ = ["install_log_handler"]

_logger = logging.getLogger("embodichain.mujoco")


def install_log_handler() -> None:
    """Send MuJoCo's warnings to the logger ``embodichain.mujoco``, at level INFO.

    INFO, because what matters of them is reported elsewhere: a divergence ends its environment and
    stands in the log and in `info`. A handler that someone else installed is left in place.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_log)


def _log(message: str | bytes) -> None:
    text = message.decode(errors="replace") if isinstance(message, bytes) else message
    _logger.info("%s", text)
