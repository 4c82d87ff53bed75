"""The process that serves a page of `viewer=web`: ``python -m ...web_process FD``.

MuJoCo Studio is native code with one user interface in a process: what goes wrong in it must not
end a training. The run's process (`web_page.py`) sends models, states and facts through a socket;
this one sends back the controls. It ends when the socket closes.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from multiprocessing.connection import Connection
from typing import Any

import mujoco
import numpy as np
from mujoco.studio import messages

from embodichain.recording.viewers.controls import Facts
from embodichain.utils.errors import ConfigError

__all__ = ["main"]

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_LOOK_SECONDS = 1.0 / 60.0


def main(descriptor: int) -> None:
    """Serve until the other end closes or says so.

    Args:
        descriptor: Of a socket; first comes a `Setup` and a model.
    """
    with Connection(descriptor) as run:
        setup, model = run.recv()
        from embodichain.recording.viewers.studio import Studio
        from embodichain.recording.viewers.web_panel import Panel

        panel = Panel(setup)
        try:
            studio = Studio(model, setup.host, setup.port, setup.title, [panel])
        except ConfigError as error:
            run.send(("failed", error.problems[0].message))
            return
        run.send(("ready", studio.url))
        reason = "The run has ended."
        try:
            reason = _Page(run, studio, panel).serve()
        except (EOFError, OSError):
            reason = "The run is gone."
        finally:
            studio.close(reason)


class _Page:
    """Passes messages on until there are no more.

    Args:
        run: The run's end.
        studio: The viewer.
        panel: The controls.
    """

    def __init__(self, run: Connection, studio: Any, panel: Any) -> None:
        self._run, self._studio, self._panel = run, studio, panel
        self._sent = panel.controls

    def serve(self) -> str:
        """Returns why it ended."""
        while True:
            # Asleep, not waiting for the socket: then a step does not pay for waking us.
            time.sleep(_LOOK_SECONDS)
            state = None
            while self._run.poll():
                kind, value = self._run.recv()
                if kind == "close":
                    return str(value)
                if kind == "model":
                    self._studio.send(messages.ModelEvent(model=value))
                    continue
                state, facts = value
                if facts is not None:
                    self._panel.tell(Facts(*facts))
            if state is not None:
                row = np.frombuffer(state).copy()
                self._studio.send(messages.StateSnapshot(state=row, state_sig=_STATE))
            self._send_controls()

    def _send_controls(self) -> None:
        if self._panel.controls.paused and not self._studio.controlled:
            self._panel.leave()
        controls = dataclasses.replace(self._panel.controls, watched=self._studio.watched)
        if controls != self._sent:
            self._sent = controls
            self._run.send(controls)


if __name__ == "__main__":
    main(int(sys.argv[1]))
