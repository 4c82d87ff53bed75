"""`NativeViewer`: MuJoCo's window with one environment. Needs a display."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from embodichain.lab.sim.drawing.marks import MarkedState, marks_of
from embodichain.lab.sim.drawing.overlays import add_geoms
from embodichain.lab.sim.drawing.states import DataState
from embodichain.utils.errors import RenderError
from embodichain.utils.system.display import has_display

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import F64, Engine

__all__ = ["NativeViewer"]


class NativeViewer:
    """A passive viewer: it never changes the simulation.

    Args:
        engine: The engine.
        env_id: The environment to show.
        on_key: Called with the code of each key pressed in the window, on the window's thread.

    Attributes:
        on_key: The same; may be replaced.

    Raises:
        RenderError: If there is no display.
    """

    def __init__(
        self,
        engine: Engine,
        env_id: int = 0,
        on_key: Callable[[int], None] | None = None,
    ) -> None:
        if not has_display():
            raise RenderError("no display to open a window on (DISPLAY is not set)")
        import mujoco.viewer

        self._engine = engine
        self._env_id = env_id
        self._model = engine.model_of(env_id)
        self._data = mujoco.MjData(self._model)
        self._marks = marks_of(self._model)
        self.on_key = on_key
        self._handle: Any = mujoco.viewer.launch_passive(
            self._model, self._data, key_callback=self._pressed
        )
        self.sync()

    def _pressed(self, key: int) -> None:
        if self.on_key is not None:
            self.on_key(key)

    @property
    def dragged(self) -> tuple[int, F64] | None:
        """The body that is dragged with the mouse, and metres (3,) to where; None if none is."""
        with self._handle.lock():
            perturb = self._handle.perturb
            body = int(perturb.select)
            if body <= 0 or not perturb.active & int(mujoco.mjtPertBit.mjPERT_TRANSLATE):
                return None
            way: F64 = np.array(perturb.refpos) - self._data.xipos[body]
            return body, way

    @property
    def is_running(self) -> bool:
        """Whether the user has the window open."""
        return bool(self._handle.is_running())

    def follow(self, engine: Engine) -> None:
        """Show the states of another engine of the same model."""
        self._engine = engine
        self.sync()

    def sync(self) -> None:
        """Show the environment's current state; does nothing once the window is closed."""
        if not self._handle.is_running():
            return
        with self._handle.lock():
            mujoco.mj_setState(
                self._model,
                self._data,
                self._engine.rows[self._env_id],
                int(mujoco.mjtState.mjSTATE_INTEGRATION),
            )
            mujoco.mj_forward(self._model, self._data)
            self._show_marks()
        self._handle.sync()

    def _show_marks(self) -> None:
        """Show halos, what is reached, and commands, beside the model."""
        commands = self._engine.commands
        scene = self._handle.user_scn
        if scene is None or not (self._marks or commands):
            return
        state = DataState(self._data)
        state.commands = [command.of_env(self._env_id) for command in commands]
        scene.ngeom = 0
        add_geoms(scene, MarkedState(state, self._marks).viewer_geoms(0))

    def close(self) -> None:
        """Close the window."""
        self._handle.close()
