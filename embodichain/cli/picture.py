"""`scene.png`: environment 0 as it starts. Kept at the start, drawn at the end.

Drawing takes a second where there is no graphics card, and nobody should wait for the first step.
"""

from __future__ import annotations

import contextlib
import logging
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["StartPicture"]

_SIZE = (1280, 960)
_log = logging.getLogger(__name__)


class StartPicture:
    """The state of environment 0 at the moment of construction.

    Args:
        env: An environment that was reset.
    """

    def __init__(self, env: BaseEnv) -> None:
        self._model = env.sim.scene.model
        self._data = env.sim.engine.data_of(0)

    def data_of(self, env_id: int) -> mujoco.MjData:
        """The kept state."""
        return self._data

    def draw(self, path: Path) -> None:
        """Write the picture; a machine without OpenGL only warns."""
        from PIL import Image

        from embodichain.lab.sim.rendering import SceneRenderer
        from embodichain.utils.errors import RenderError

        try:
            renderer = SceneRenderer(self._model, *_SIZE)
            pixels = renderer.draw(self, 0, "default")
            renderer.close()
        except RenderError as error:
            _log.warning("no scene.png: %s", error)
            return
        temporary = path.with_name(f".{path.name}")
        try:
            Image.fromarray(pixels).save(temporary, format="PNG")
            temporary.replace(path)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            _log.warning("no scene.png: %s", error)
