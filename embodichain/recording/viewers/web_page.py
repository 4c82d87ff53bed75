"""`WebPage`: shows rows of state of one model on MuJoCo Studio's page.

`web.py` shows a running environment with it, `replay --view` a log. The page itself is served by
another process, `web_process.py`.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.viewers.controls import Controls, Facts, Setup
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.cpu import CpuEngine

__all__ = ["LOOKS", "WebPage"]

_log = logging.getLogger(__name__)
_PROCESS = "embodichain.recording.viewers.web_process"
_END_SECONDS = 10.0
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
    """A page that shows one of several environments; without a browser nothing waits for it.

    Args:
        model: The model of the environment that is shown first.
        host: The address to listen on.
        port: The port; None is the first free one from 8080.
        title: Of the page and its panel.
        num_envs: How many environments can be chosen from.
        env_id: The one shown first.
        realtime: Whether `pace` first keeps to the clock.
        resets: Whether resets may be requested.
        stopped: Whether to end all waiting.

    Attributes:
        url: Where the page is.

    Raises:
        ConfigError: The address cannot be listened on.
    """

    is_open = True

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
        self._controls = Controls(env_id=env_id, speed=1.0 if realtime else None)
        self._stopped = stopped
        self._looks = _looks_of(model)
        self._taken_steps = self._taken_resets = 0
        self._due: float | None = None
        setup = Setup(host, port, title, num_envs, resets, self._controls)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the page
        self._page, self._process = _start(self._errors)
        self._room = select.poll()
        self._room.register(self._page.fileno(), select.POLLOUT)
        self._listener: threading.Thread | None = None
        self._closed = False
        try:
            self._page.send((setup, model))
            kind, value = self._page.recv()
        except (EOFError, OSError):
            kind, value = "failed", f"MuJoCo's web viewer does not start{self._last_words()}"
        if kind == "failed":
            self.close()
            raise ConfigError([Problem("viewer", value)])
        self.url: str = value
        self._listener = threading.Thread(target=self._listen, name="web viewer", daemon=True)
        self._listener.start()

    @property
    def watched(self) -> bool:
        """Whether a browser has the page open; cheap."""
        return self._controls.watched

    @property
    def env_id(self) -> int:
        """The chosen environment."""
        return self._controls.env_id

    @property
    def fast(self) -> bool:
        """Whether steps come as fast as they are made: not each is worth showing."""
        return self._controls.speed is None

    def begin(self, engine: CpuEngine) -> None:
        """Show states of an engine's environment 0 from now on."""
        self.show_model(engine.model_of(0))

    def show_model(self, model: mujoco.MjModel) -> None:
        """Show states of another model from now on, if it looks different.

        Args:
            model: Another environment's, or the same one's after a change.
        """
        looks = _looks_of(model)
        if looks != self._looks:
            self._looks = looks
            self._send("model", model)

    def show(self, row: F64, facts: Facts | None = None) -> None:
        """Show a state; it is left out if the other process is behind.

        Args:
            row: (nstate,) integration state; copied.
            facts: What to write beside it; None leaves what was there.
        """
        if self._room.poll(0):  # plain values: pickling them takes a fifth of the time
            told = None if facts is None else facts.plain()
            self._send("state", (np.asarray(row, np.float64).tobytes(), told))

    def pace(self, seconds: float, changed: Callable[[], None] = lambda: None) -> None:
        """Wait for the clock, and while paused, until the next step; not without a browser.

        Args:
            seconds: Simulated time between two steps.
            changed: Shows the state; called as a pause begins, and when another environment is
                chosen in it.
        """
        shown = -1
        while self._controls.paused and self._waits() and not self._take_step():
            if self.env_id != shown:
                shown = self.env_id
                changed()
            time.sleep(_NAP)
        if not self._controls.paused:
            self._taken_steps = self._controls.steps
        speed = self._controls.speed
        if speed is None or not self.watched:
            self._due = None
            return
        now = time.monotonic()
        due = now if self._due is None else self._due + seconds / speed
        self._due = due = max(due, now - _LATE)
        while (left := due - time.monotonic()) > 0 and not self._controls.paused and self._waits():
            time.sleep(min(left, _NAP))

    def take_reset(self) -> int | None:
        """Return the environment of a requested reset, once; else None."""
        controls = self._controls
        if controls.resets == self._taken_resets:
            return None
        self._taken_resets = controls.resets
        return controls.reset_env

    def close(self) -> None:
        """Serve no longer; again is nothing."""
        if self._closed:
            return
        self._send("close", "The run has ended.")
        self._closed = True
        try:
            self._process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._listener is not None:
            self._listener.join()
        self._page.close()
        self._errors.close()

    # -- the other process -----------------------------------------------------------------------

    def _send(self, kind: str, value: Any) -> None:
        with contextlib.suppress(OSError):  # it is gone: `_listen` has said so, or will
            self._page.send_bytes(pickle.dumps((kind, value), pickle.HIGHEST_PROTOCOL))

    def _listen(self) -> None:
        """Receive controls until the other process ends."""
        try:
            while True:
                self._controls = self._page.recv()
        except (EOFError, OSError):
            self._controls = Controls(env_id=self.env_id)
            if not self._closed:
                _log.warning("the web viewer has ended; the run goes on%s", self._last_words())

    def _last_words(self) -> str:
        self._errors.seek(0)
        words = self._errors.read().decode(errors="replace").strip()
        return f": {words.splitlines()[-1]}" if words else ""

    def _take_step(self) -> bool:
        if self._controls.steps == self._taken_steps:
            return False
        self._taken_steps += 1
        return True

    def _waits(self) -> bool:
        return self.watched and not self._stopped()


def _start(errors: Any) -> tuple[Connection, subprocess.Popen[bytes]]:
    """Start the other process; it hears no Ctrl-C, and ends with our end of the socket."""
    ours, theirs = socket.socketpair()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", _PROCESS, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdin=subprocess.DEVNULL,
            stdout=errors,
            stderr=errors,
            start_new_session=True,
        )
    return Connection(ours.detach()), process


def _looks_of(model: mujoco.MjModel) -> bytes:
    """What decides how a model looks, to compare."""
    return b"".join(np.asarray(getattr(model, field)).tobytes() for field in LOOKS)
