"""`WebPage`: shows states of a model on MuJoCo Studio's page.

`web.py` uses it for a running environment, `replay --view` for a log. Another process
(`web_process.py`) serves the page: it receives models, states and `Facts`, and sends `Controls`.
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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

from embodichain.lab.gym.teleop import ToolCommand
from embodichain.lab.sim.drawing.commands import ShownCommand
from embodichain.lab.sim.engine.api import F64
from embodichain.utils.errors import ConfigError, EmbodichainError, Problem
from embodichain.utils.system import platforms
from embodichain.utils.system.access import Access
from embodichain.utils.system.processes import own_process

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import Engine

__all__ = ["LOOKS", "SPEEDS", "Controls", "Facts", "PageOptions", "WebPage"]

_log = logging.getLogger(__name__)
_PROCESS = "embodichain.recording.viewers.page.web_process"
_END_SECONDS = 10.0
_NAP = 0.02
_LATE = 0.1
_SHOWN_AGAIN = 0.2

SPEEDS: tuple[float | None, ...] = (None, 2.0, 1.0, 0.5, 0.25, 0.1)
"""Multiples of real time; None is unlimited."""
LOOKS = (
    *("body_pos", "body_quat", "body_ipos", "jnt_pos", "jnt_axis"),
    *("geom_pos", "geom_quat", "geom_size", "geom_rgba", "site_pos", "site_quat", "site_size"),
    *("site_rgba", "mat_rgba", "light_pos", "light_dir", "light_diffuse", "light_ambient"),
    *("light_specular", "cam_pos", "cam_quat", "cam_fovy"),
)
"""Fields of a model that affect its appearance; they may differ between environments."""


class Facts(NamedTuple):
    """One step of the environment that is shown.

    Attributes:
        step: Number of the control step, from 0.
        seconds: Simulated time since the start of the episode.
        lines: Further lines, as name and text.
        rewards: Term to its part of this step's reward: value times weight.
        sums: Term to the sum of these over the episode.
    """

    step: int
    seconds: float
    lines: tuple[tuple[str, str], ...] = ()
    rewards: Mapping[str, float] = {}
    sums: Mapping[str, float] = {}


@dataclass(frozen=True, slots=True)
class Controls:
    """The state of the page's controls.

    Attributes:
        env_id: The environment to show.
        speed: One of `SPEEDS`.
        paused: Whether the run is paused.
        watched: Whether a browser has the page open.
        steps: Number of requests for a single step.
        resets: Number of requests for a reset.
        reset_env: The environment of the last reset.
        command: The operator's, if the page moves a robot.
        operated: Whether an operator is there.
    """

    env_id: int = 0
    speed: float | None = 1.0
    paused: bool = False
    watched: bool = False
    steps: int = 0
    resets: int = 0
    reset_env: int = 0
    command: ToolCommand = ToolCommand()
    operated: bool = False


@dataclass(frozen=True, slots=True)
class PageOptions:
    """Address and initial state of a page.

    Attributes:
        host: The address to listen on.
        port: The port; None is the first free one from 8080.
        env_id: The environment that is shown first.
        realtime: Whether the speed is initially real time while the page is open.
        resets: Whether the page may end episodes, as truncated.
        title: Title of the page and its panel.
        teleop: Whether a person moves a robot's tool on the page.
        access: Who may use the page: a drawn token by default.
    """

    host: str = "127.0.0.1"
    port: int | None = None
    env_id: int = 0
    realtime: bool = True
    resets: bool = True
    title: str = "embodichain"
    teleop: bool = False
    access: Access = Access()


class WebPage:
    """A page that shows one of several environments; it never waits without a browser.

    Args:
        model: The model of the environment that is shown first.
        options: Address of the page, and its initial state.
        num_envs: Number of environments to choose from.
        stopped: Whether to end all waiting.

    Attributes:
        url: Address of the page, with its token.
        url_once: An address that opens the page once, for a browser's command line.
        address: The address without a token, for logs.

    Raises:
        ConfigError: If the address cannot be listened on, or `options.access` does not fit it.
    """

    is_open = True

    def __init__(
        self,
        model: mujoco.MjModel,
        options: PageOptions | None = None,
        *,
        num_envs: int = 1,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        options = options or PageOptions()
        self._controls = Controls(options.env_id, 1.0 if options.realtime else None)
        self._stopped = stopped
        self._looks = _looks_of(model)
        self._taken_steps = self._taken_resets = 0
        self._due: float | None = None
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the page
        self._page, self._process = _start(self._errors)
        self._writable = select.poll()
        self._writable.register(self._page.fileno(), select.POLLOUT)
        self._listener: threading.Thread | None = None
        self._closed = self._ended = False
        try:
            self._page.send((options, num_envs, self._controls, model))
            kind, value = self._page.recv()
        except (EOFError, OSError):
            value = "viewer", f"MuJoCo's web viewer does not start{self._last_error()}", ""
            kind = "failed"
        if kind == "failed":
            self.close()
            raise ConfigError([Problem(*value)])
        self.url: str = value[0]
        self.url_once: str = value[1]
        self.address = self.url.partition("?")[0]
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
        """Whether the speed is unlimited, so that not every step needs to be shown."""
        return self._controls.speed is None

    @property
    def command(self) -> ToolCommand:
        """The operator's present command."""
        return self._controls.command

    def wait_for_operator(
        self, show: Callable[[], None], until: Callable[[], bool] = lambda: True
    ) -> None:
        """Return at once if an operator is there; else wait for one, or for the end of the run.

        Args:
            show: Shows the state; called while somebody watches.
            until: What to wait for besides.

        Raises:
            EmbodichainError: If the process that serves the page has ended.
        """
        shown = 0.0
        while not (self._controls.operated and until()) and not self._stopped():
            if self._ended:
                raise EmbodichainError(
                    "the web viewer has ended, so the robot can no longer be operated"
                )
            if self.watched and time.monotonic() - shown > _SHOWN_AGAIN:
                shown = time.monotonic()
                show()
            time.sleep(_NAP)

    def tell(self, status: Mapping[str, Any]) -> None:
        """Show an operator plain values, see `operator_pages`; skipped if the process is behind."""
        if self._writable.poll(0):
            self._send("status", dict(status))

    def begin(self, engine: Engine) -> None:
        """Show states of an engine's environment 0 from now on."""
        self.show_model(engine.model_of(0))

    def show_model(self, model: mujoco.MjModel) -> None:
        """Show states of another model from now on, if it looks different.

        Args:
            model: The model of another environment, or the changed model of the same one.
        """
        looks = _looks_of(model)
        if looks != self._looks:
            self._looks = looks
            self._send("model", model)

    def show(
        self,
        row: F64,
        facts: Facts | None = None,
        commands: Sequence[ShownCommand] = (),
    ) -> None:
        """Show a state; it is skipped if the other process is behind.

        Args:
            row: (nstate,) integration state; copied.
            facts: Text to show next to it; None keeps the previous one.
            commands: Those of the environment, which are shown as arrows.
        """
        if self._writable.poll(0):  # plain values: pickling them is faster by a factor of 5
            plain_facts = None if facts is None else tuple(facts)
            state = np.asarray(row, np.float64).tobytes()
            self._send("state", (state, plain_facts, list(commands)))

    def pace(self, seconds: float, changed: Callable[[], None] = lambda: None) -> None:
        """Wait for real time, and while paused, until the next step; return at once if no browser.

        Args:
            seconds: Simulated time between two steps.
            changed: Shows the state; called when a pause begins, and when another environment is
                chosen during the pause.
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

    def finish(self) -> None:
        """Say in the panel that the run is over: there is nothing to pause or to reset."""
        self._send("finish", None)

    def take_reset(self) -> int | None:
        """Return the environment of a requested reset, once; else None."""
        controls = self._controls
        if controls.resets == self._taken_resets:
            return None
        self._taken_resets = controls.resets
        return controls.reset_env

    def close(self) -> None:
        """Stop serving. A second call does nothing."""
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
        with contextlib.suppress(OSError):  # the process has ended: `_listen` logs that
            self._page.send_bytes(pickle.dumps((kind, value), pickle.HIGHEST_PROTOCOL))

    def _listen(self) -> None:
        """Receive controls until the other process ends."""
        try:
            while True:
                self._controls = self._page.recv()
        except (EOFError, OSError):
            self._controls = Controls(env_id=self.env_id)
            self._ended = True
            if not self._closed:
                _log.warning("the web viewer has ended; the run continues%s", self._last_error())

    def _last_error(self) -> str:
        self._errors.seek(0)
        text = self._errors.read().decode(errors="replace").strip()
        return f": {text.splitlines()[-1]}" if text else ""

    def _take_step(self) -> bool:
        if self._controls.steps == self._taken_steps:
            return False
        self._taken_steps += 1
        return True

    def _waits(self) -> bool:
        return self.watched and not self._stopped()


def _start(errors: Any) -> tuple[Connection, subprocess.Popen[bytes]]:
    """Start the other process; it gets no Ctrl-C, and ends when our end of the socket closes."""
    platforms.need("viewer=web")
    ours, theirs = socket.socketpair()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", _PROCESS, str(theirs.fileno()), str(own_process())],
            pass_fds=[theirs.fileno()],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdin=subprocess.DEVNULL,
            stdout=errors,
            stderr=errors,
            start_new_session=True,
        )
    return Connection(ours.detach()), process


def _looks_of(model: mujoco.MjModel) -> bytes:
    """The values of `LOOKS`, to compare."""
    return b"".join(np.asarray(getattr(model, field)).tobytes() for field in LOOKS)
