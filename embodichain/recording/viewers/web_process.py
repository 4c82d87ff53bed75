"""The process that serves a page of `viewer=web`: ``python -m ...web_process FD``.

MuJoCo Studio is native code with one user interface in a process: what goes wrong in it must not
end a training. The run's process (`web_page.py`) sends models, states and facts through a socket;
this one sends back what people wish for. It ends when the socket does.
"""

from __future__ import annotations

import dataclasses
import sys
from multiprocessing.connection import Connection
from typing import Any

import mujoco

from embodichain.recording.viewers.controls import Facts
from embodichain.utils.errors import ConfigError

__all__ = ["main"]

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_LOOK_SECONDS = 0.02


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
        studio: What shows.
        panel: What asks.
    """

    def __init__(self, run: Connection, studio: Any, panel: Any) -> None:
        self._run, self._studio, self._panel = run, studio, panel
        self._sent = panel.wishes

    def serve(self) -> str:
        """Returns why it ended."""
        while True:
            if self._run.poll(_LOOK_SECONDS):
                kind, value = self._run.recv()
                if kind == "close":
                    return str(value)
                self._show(kind, value)
            self._tell_wishes()

    def _show(self, kind: str, value: Any) -> None:
        from mujoco.studio import messages

        if kind == "model":
            self._studio.send(messages.ModelEvent(model=value))
            return
        row, facts = value
        self._studio.send(messages.StateSnapshot(state=row, state_sig=_STATE))
        if isinstance(facts, Facts):
            self._panel.tell(facts)
        self._run.send(("shown", None))

    def _tell_wishes(self) -> None:
        if self._panel.wishes.paused and not self._studio.controlled:
            self._panel.leave()
        wishes = dataclasses.replace(self._panel.wishes, watched=self._studio.watched)
        if wishes != self._sent:
            self._sent = wishes
            self._run.send(("wishes", wishes))


if __name__ == "__main__":
    main(int(sys.argv[1]))
