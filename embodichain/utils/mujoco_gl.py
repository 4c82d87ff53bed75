"""`check_mujoco_gl`: a value of MUJOCO_GL with which MuJoCo cannot be imported is refused."""

from __future__ import annotations

import os

from embodichain.utils.errors import ConfigError, Problem

__all__ = ["check_mujoco_gl"]

_VARIABLE = "MUJOCO_GL"


def check_mujoco_gl() -> None:
    """Import MuJoCo if MUJOCO_GL is set: it loads the library of OpenGL that this names.

    Raises:
        ConfigError: If there is no such library.
    """
    named = os.environ.get(_VARIABLE)
    if not named:
        return
    try:
        import mujoco  # noqa: F401
    except (AttributeError, ImportError, OSError, RuntimeError) as error:
        message = (
            f"MuJoCo cannot be imported with {named!r} ({error}); unset it, or use egl, "
            "osmesa (`apt-get install libosmesa6`), glfw (needs a display) or disable"
        )
        raise ConfigError([Problem(_VARIABLE, message, source="environment variable")]) from error
