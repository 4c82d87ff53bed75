"""`WebPage`: one model on MuJoCo Studio's page, for whoever has rows of state to show.

It knows no environment: `web.py` shows a running one with it, `replay --view` a log.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.viewers.controls import Controls, Facts

__all__ = ["LOOKS", "WebPage"]

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_NAP = 0.02
_LATE = 0.1

LOOKS = (
    *("body_pos", "body_quat", "body_ipos", "jnt_pos", "jnt_axis"),
    *("geom_pos", "geom_quat", "geom_size", "geom_rgba", "site_pos", "site_quat", "site_size"),
    *("site_rgba", "mat_rgba", "light_pos", "light_dir", "light_diffuse", "light_ambient"),
    *("light_specular", "cam_pos", "cam_quat", "cam_fovy"),
)
"""Fields of a model that decide how it looks; another environment's may differ."""


class WebPage:
    """A page that shows one of several environments; nothing is computed while nobody looks.

    A process has one page at a time.

    Args:
        model: The model of the environment that is shown first.
        host: The address to listen on.
        port: The port; None is the first free one from 8080.
        title: Of the page and its panel.
        num_envs: How many environments can be chosen from.
        env_id: The one shown first.
        realtime: Whether `pace` keeps to the clock first; people can change it.
        resets: Whether people may ask for a reset.
        stopped: Whether to wait for nobody any more.

    Raises:
        ConfigError: The address cannot be listened on; or there is a page already.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        host: str = "127.0.0.1",
        port: int | None = None,
        *,
        title: str = "embodichain",
        num_envs: int = 1,
        env_id: int = 0,
        realtime: bool = True,
        resets: bool = True,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        from embodichain.recording.viewers.studio import Studio
        from embodichain.recording.viewers.web_panel import Panel

        self._controls = Controls(num_envs, env_id, realtime, resets)
        self._stopped = stopped
        self._looks = _looks_of(model)
        self._due: float | None = None
        self._studio = Studio(model, host, port, title, [Panel(title, self._controls)])
        self.url = self._studio.url

    @property
    def watched(self) -> bool:
        """Whether somebody has the page open. Cheap: ask before computing what to show."""
        return self._studio.watched

    @property
    def env_id(self) -> int:
        """The environment that people want to see."""
        return self._controls.env_id

    @property
    def fast(self) -> bool:
        """Whether steps come as fast as they are made: not each is worth showing."""
        return self._controls.speed is None

    def show_model(self, model: mujoco.MjModel) -> None:
        """Show states of another model from now on, if it looks different.

        Args:
            model: Another environment's, or the same one's after a change; copied.
        """
        from mujoco.studio import messages

        looks = _looks_of(model)
        if looks != self._looks:
            self._looks = looks
            self._studio.send(messages.ModelEvent(model=model))

    def show(self, row: F64, facts: Facts | None = None) -> None:
        """Show a state.

        Args:
            row: (nstate,) integration state; copied.
            facts: What to write beside it; None leaves what was there.
        """
        from mujoco.studio import messages

        self._studio.send(messages.StateSnapshot(state=np.array(row, np.float64), state_sig=_STATE))
        if facts is not None:
            self._controls.tell(facts)

    def pace(self, seconds: float, changed: Callable[[], None]) -> None:
        """Wait as people want it: for the clock, and while they pause. Returns for the next step.

        Does not wait while nobody looks.

        Args:
            seconds: Simulated time between two steps.
            changed: Called when another environment is chosen during a pause.
        """
        controls = self._controls
        shown = controls.env_id
        while controls.paused and self._waits() and not controls.take_step():
            if controls.env_id != shown:
                shown = controls.env_id
                changed()
            time.sleep(_NAP)
        if not self.watched:
            controls.leave()
        speed = controls.speed
        if speed is None or not self.watched:
            self._due = None
            return
        now = time.monotonic()
        due = now if self._due is None else self._due + seconds / speed
        self._due = due = max(due, now - _LATE)
        while (left := due - time.monotonic()) > 0 and not controls.paused and self._waits():
            time.sleep(min(left, _NAP))

    def take_reset(self) -> int | None:
        """The environment whose episode people want to end, once; else None."""
        return self._controls.take_reset()

    def close(self) -> None:
        """Serve no longer; again is nothing."""
        self._studio.close("The run has ended.")

    def _waits(self) -> bool:
        return self.watched and not self._stopped()


def _looks_of(model: mujoco.MjModel) -> bytes:
    """What decides how a model looks, to compare."""
    return b"".join(np.asarray(getattr(model, field)).tobytes() for field in LOOKS)
