"""The process that serves a page of `viewer=web`: ``python -m ...web_process FD PROCESS``.

MuJoCo Studio is native code with one user interface per process; a failure there must not end a
training. The run's process (`web_page.py`) sends models, states and facts through a socket; this
process sends back the controls. It ends when the socket closes, and with the run's process, of
which a fork could hold the socket open.

MuJoCo 4.0's web viewer listens on every interface, accepts files dropped on its page, answers
pages of other sites, asks for no token, and has a second port, to which its own native code
connects. `_Viewer` sets the address, `web_guard.py` checks every request first, and `own_socket.py`
refuses other processes at the second port. If a version of MuJoCo does not allow these changes,
nothing is served.
"""

from __future__ import annotations

import dataclasses
import math
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any

import mujoco
import numpy as np
from mujoco.studio import launch_thread, messages, plugin, ux, viewer_protocol, web_viewer
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.implot import implot
from mujoco.studio.web import web_server

from embodichain.lab.sim.compiler.sensing.views import DEFAULT_VIEW
from embodichain.lab.sim.drawing.commands import ShownCommand
from embodichain.lab.sim.drawing.marks import Mark, MarkedState, marks_of
from embodichain.lab.sim.drawing.states import DataState
from embodichain.recording.viewers.door import Door
from embodichain.recording.viewers.operators.operator_pages import (
    OperatorPages,
    View,
    look_like,
    view_of,
)
from embodichain.recording.viewers.page.own_socket import OwnSocket
from embodichain.recording.viewers.page.web_guard import GUARDS, Guard, guard_serving
from embodichain.recording.viewers.page.web_page import SPEEDS, Controls, Facts, PageOptions
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.number_text import signed_number
from embodichain.utils.system.addresses import reachable
from embodichain.utils.system.processes import ProcessId, end_with

__all__ = ["Panel", "Place", "Studio", "main", "panel_place"]

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_POLL_SECONDS = 1.0 / 60.0
_START_SECONDS = 20.0
_MOST_TRIES = 20
"""How often another free port is tried."""
_IDLE_SECONDS = 0.05
_WIDTH = 330.0
_HEIGHT = 640.0
_MARGIN = 8.0
_NARROW = 2.0 * (_MARGIN + _WIDTH)
"""A page that is narrower has the panel below the scene instead of beside it."""
_SHARE_BELOW = 0.38
"""Share of the page's height that the panel has there."""
_BUTTON = imgui.Vec2(70.0, 0.0)
_THEIR_ADVICE = "Pass a different --port"
"""Beginning of the part of MuJoCo's message about an option of its own program."""
_PLOT_HEIGHT = 180.0
_LEGEND_MARGIN = 30.0
_LEGEND_LINE = 20.0
_HISTORY = 400
"""Number of steps with plotted rewards."""


def main(descriptor: int) -> None:
    """Serve until the run closes the socket or sends an end.

    Args:
        descriptor: Descriptor of a socket; the first message is options, number of environments,
            controls and model.
    """
    with Connection(descriptor) as run:
        options, num_envs, controls, model = run.recv()
        changed = threading.Event()
        operators = OperatorPages(changed) if options.teleop else None
        panel = Panel(options, num_envs, controls, operators)
        try:
            studio = Studio(model, options, panel, operators=operators)
        except ConfigError as error:
            problem = error.problems[0]
            run.send(("failed", (problem.path, problem.message, problem.hint)))
            return
        run.send(("ready", (studio.url, studio.url_once)))
        reason = "The run has ended."
        try:
            reason = _serve(run, studio, panel, operators, changed)
        except (EOFError, OSError):
            reason = "The run is gone."
        finally:
            studio.close(reason)


def _serve(
    run: Connection,
    studio: Studio,
    panel: Panel,
    operators: OperatorPages | None,
    changed: threading.Event,
) -> str:
    """Forward messages until there are no more; return why it ended."""
    sent = panel.controls
    pauses = 0
    while True:
        # Poll instead of waiting on the socket, so that a step does not have to wake this process.
        changed.wait(_POLL_SECONDS)
        changed.clear()
        state = None
        while run.poll():
            kind, value = run.recv()
            if kind == "close":
                return str(value)
            if kind == "finish":
                panel.finish()
                continue
            if kind == "model":
                studio.send(messages.ModelEvent(model=value))
                continue
            if kind == "status":
                if operators is not None:
                    operators.tell(value)
                continue
            state, facts, commands = value
            studio.show_commands(commands)
            if facts is not None:
                panel.add(Facts(*facts))
        if state is not None:
            row = np.frombuffer(state).copy()
            studio.send(messages.StateSnapshot(state=row, state_sig=_STATE))
        if panel.controls.paused and not studio.controlled:
            panel.resume()
        is_watched = studio.watched
        if is_watched and not sent.watched:
            panel.begin_part()
        controls = dataclasses.replace(panel.controls, watched=is_watched)
        if operators is not None:
            if operators.pauses != pauses:
                pauses = operators.pauses
                panel.pause()
            command = operators.command
            operated = operators.operated
            controls = dataclasses.replace(controls, command=command, operated=operated)
        if controls != sent:
            sent = controls
            run.send(controls)


# -- serving ---------------------------------------------------------------------------------------


class Studio:
    """Serves a model's page on its own threads until it is closed; at most once in a process.

    Args:
        model: The first model to show; copied.
        options: Address, port and title, and who may use it.
        plugins: Studio's viewer plugins.
        operators: The operator's place, if the page moves a robot.

    Attributes:
        url: Address of the page, with its token.
        url_once: An address that opens the page once.

    Raises:
        ConfigError: If the address cannot be listened on, `options.access` does not fit it, or
            this version of MuJoCo's viewer cannot be restricted to it.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        options: PageOptions,
        *plugins: Any,
        operators: OperatorPages | None = None,
    ) -> None:
        door = Door(options.host, options.access)
        viewers: list[_Viewer] = []  # one, made in the server's thread
        ready = threading.Event()

        def run(endpoint: Any) -> None:
            try:
                config = viewer_protocol.ViewerConfig(
                    title=options.title, gfx="web", http_port=options.port or 0
                )
                viewer = _Viewer(
                    options,
                    door,
                    operators,
                    config,
                    endpoint,
                    model=model,
                    plugins=[*plugins],
                )
                viewers.append(viewer)
            finally:
                ready.set()
            viewer_protocol.run_viewer_loop(viewer)

        guard_serving()
        self._handle = launch_thread.launch_thread(run)
        ready.wait(_START_SECONDS)
        if not viewers:
            try:
                self._handle.close()  # raises the error of its thread
                raise RuntimeError("MuJoCo's viewer does not start")
            except Exception as error:
                port = f":{options.port}" if options.port else ""
                reason = str(error).partition(_THEIR_ADVICE)[0].strip()
                why = f"cannot listen on {options.host}{port}: {reason}"
                hint = "viewer.port=N is another; without it a free one is taken"
                raise ConfigError([Problem("viewer.port", why, hint)]) from error
        viewer = viewers[0]
        self._viewer = viewer
        self._guard = viewer.guard
        self.url = f"{viewer.url}{door.query}"
        self.url_once = f"{viewer.url}{door.query_once()}"

    @property
    def watched(self) -> bool:
        """Whether a browser has the page open."""
        return bool(self._guard.connections)

    @property
    def controlled(self) -> bool:
        """Whether a browser has the panel; further browsers only show the scene."""
        return "/ui" in self._guard.connections

    def send(self, message: Any) -> None:
        """Send the viewer one of Studio's messages."""
        self._handle.send_to_viewer(message)

    def show_commands(self, commands: Sequence[ShownCommand]) -> None:
        """Show commands of the environment from now on; each has one row of numbers."""
        self._viewer.commands = commands

    def close(self, reason: str) -> None:
        """Stop serving; open pages show the reason."""
        self._handle.close(reason)


class _Viewer(web_viewer.WebViewer):  # type: ignore[misc]
    """Studio's web viewer, which listens on `_host`; here that is the configured address."""

    guard: Guard
    _http_sock: socket.socket
    _tcp_sock: socket.socket

    def __init__(
        self,
        options: PageOptions,
        door: Door,
        operators: OperatorPages | None,
        *args: Any,
        **kwargs: Any,
    ) -> None:
        self._options = options
        self._door = door
        self._operators = operators
        self._scene: tuple[Any, mujoco.MjvScene] | None = None  # a model, and a scene made for it
        self._marks: tuple[Any, list[Mark]] | None = None  # a model, and its marks
        self.commands: Sequence[ShownCommand] = ()
        super().__init__(*args, **kwargs)

    @property
    def _host(self) -> str:
        return self._options.host

    @_host.setter
    def _host(self, every_interface: str) -> None:
        """Ignore the address that MuJoCo would listen on."""

    @property
    def url(self) -> str:
        """Address of the page, for a browser on this machine."""
        return f"http://{reachable(self._options.host)}:{self._http_sock.getsockname()[1]}/"

    def _start_server(self) -> None:
        """Start serving, if the socket is the expected one and requests are checked."""
        bound = self._http_sock.getsockname()[0]
        if bound not in {info[4][0] for info in socket.getaddrinfo(self._options.host, None)}:
            raise RuntimeError(f"MuJoCo {mujoco.__version__} listens on {bound}")
        self._listen()
        self._tcp_sock = OwnSocket(self._tcp_sock)
        self.guard = GUARDS[self._http_sock] = Guard(
            self._door, self._operators, self._options.title
        )
        super()._start_server()
        if self._web_server.tcp_sock is not self._tcp_sock:
            self._web_server.stop()
            raise RuntimeError(f"MuJoCo {mujoco.__version__} draws its panel in another way")
        if not self.guard.serving.wait(_START_SECONDS):
            self._web_server.stop()
            raise RuntimeError(f"requests to MuJoCo {mujoco.__version__}'s viewer are not checked")

    def _listen(self) -> None:
        """Listen, here and not in the server's thread, so that it fails here if it cannot.

        Between the choice of a free port and this call another program may have taken it: then
        the next one is chosen.
        """
        for _ in range(_MOST_TRIES):
            try:
                self._http_sock.listen()
                return
            except OSError:
                if self._options.port is not None:
                    raise
            self._http_sock.close()
            self._http_sock = web_server.bind_public_socket(self._host)
        self._http_sock.listen()

    def prepare_next_frame(self) -> bool:
        """Draw only if a page is open."""
        if not self.guard.connections:
            time.sleep(_IDLE_SECONDS)
            return False
        ready: bool = super().prepare_next_frame()
        if self._operators is not None:
            self._operators.view = self._view()
        return ready

    def sync(self) -> None:
        """Send the state, with halos, what is reached, and commands as further geoms."""
        if self._marks is None or self._marks[0] is not self.model:
            self._marks = (self.model, marks_of(self.model))
        state = DataState(self.data)
        state.commands = self.commands
        marked = MarkedState(state, self._marks[1])
        self.extra_geoms = [geom.made() for geom in marked.viewer_geoms(0)]
        super().sync()

    def _view(self) -> View:
        """The camera of the page, which the controlling browser moves."""
        if self._scene is None or self._scene[0] is not self.model:
            self._scene = (self.model, mujoco.MjvScene(self.model, 1))
        return view_of(self.model, self.data, self.camera, self._scene[1])

    def get_drop_file(self) -> str:
        """Ignore dropped files."""
        return ""


# -- the panel -------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, slots=True)
class Place:
    """A rectangle of the page, in its pixels.

    Attributes:
        x: From the left.
        y: From the top.
        width: Its width.
        height: Its height.
    """

    x: float
    y: float
    width: float
    height: float


def panel_place(width: float, height: float) -> Place:
    """Where the panel is on a page: beside the scene, or below it on a phone.

    Args:
        width: Of the page, without Studio's line at its bottom; in pixels.
        height: Likewise.
    """
    if width >= _NARROW:
        free_height = height - 2.0 * _MARGIN
        return Place(x=_MARGIN, y=_MARGIN, width=_WIDTH, height=min(_HEIGHT, free_height))
    panel_height = _SHARE_BELOW * height
    top = height - _MARGIN - panel_height
    return Place(x=_MARGIN, y=top, width=width - 2.0 * _MARGIN, height=panel_height)


class Panel(plugin.ViewerPlugin):  # type: ignore[misc]
    """Controls for environment, pause, step, reset and speed; rewards per term; view options.

    Args:
        options: Title, and whether resets are offered.
        num_envs: Number of environments to choose from.
        controls: The initial controls.
        operators: The operator's place, whose keys replace the panel's.

    Attributes:
        controls: Current controls; the object is replaced in the viewer's thread, by `pause` and by
            `resume`.
    """

    def __init__(
        self,
        options: PageOptions,
        num_envs: int,
        controls: Controls,
        operators: OperatorPages | None = None,
    ) -> None:
        self._options = options
        self._num_envs = num_envs
        self.controls = controls
        self._operators = operators
        self._changing = threading.Lock()
        self._facts: Facts | None = None
        self._history: deque[Facts] = deque(maxlen=_HISTORY)
        self._camera = ux.UxState()
        self._open = True
        self._is_over = False
        self._place: Place | None = None

    def add(self, facts: Facts) -> None:
        """Show the facts of a step; a log that begins again begins a new plot."""
        if self._history and facts.step < self._history[-1].step:
            self._history.clear()
        self._facts = facts
        self._history.append(facts)

    def begin_part(self) -> None:
        """Leave a gap in the plot: nobody watched until now, so there are no facts of that time."""
        if self._history:
            last = self._history[-1]
            nothing = dict.fromkeys(last.rewards, math.nan)
            self._history.append(last._replace(rewards=nothing))

    def finish(self) -> None:
        """Say that the run is over."""
        self._is_over = True

    def resume(self) -> None:
        """End a pause."""
        self._change(paused=False)

    def _choose(self, env_id: int) -> None:
        chosen = min(max(env_id, 0), self._num_envs - 1)
        if chosen != self.controls.env_id:
            self._history.clear()
            self._change(env_id=chosen)

    def pause(self) -> None:
        """Begin or end a pause."""
        self._change(paused=not self.controls.paused)

    def _step(self) -> None:
        self._change(paused=True, steps=self.controls.steps + self.controls.paused)

    def _reset(self) -> None:
        if self._operators is not None:
            self._operators.discard()
        elif self._options.resets:
            self._change(resets=self.controls.resets + 1, reset_env=self.controls.env_id)

    def _change(self, **changed: Any) -> None:
        with self._changing:
            self.controls = dataclasses.replace(self.controls, **changed)

    @messages.handler(priority=messages.Priority.CRITICAL)  # type: ignore[untyped-decorator]
    def _on_init(self, _: plugin.ViewerInitEvent) -> None:
        ux.setup_theme(ux.GuiTheme.DARK)
        self._camera.camera_index = ux.set_camera(
            self.viewer.model, self.viewer.camera, ux.TUMBLE_CAMERA_IDX
        )
        look_like(self.viewer.model, self.viewer.camera, DEFAULT_VIEW)

    @messages.handler  # type: ignore[untyped-decorator]
    def _on_update(self, _: messages.UpdateEvent) -> None:
        if self._operators is not None:
            return  # the page has keys of its own
        if imgui.GetIO().WantCaptureKeyboard:
            return
        if imgui.IsKeyChordPressed(imgui.Key.Space):
            self.pause()
        elif imgui.IsKeyChordPressed(imgui.Key.RightArrow):
            self._step()
        elif imgui.IsKeyChordPressed(imgui.Key.Backspace):
            self._reset()
        elif imgui.IsKeyChordPressed(imgui.Key.P):
            self._open = not self._open

    @messages.handler  # type: ignore[untyped-decorator]
    def _on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        self.viewer.camera_index = self._camera.camera_index
        if not self._open:
            return
        display = imgui.GetIO().DisplaySize
        place = panel_place(display.x, display.y)
        if place != self._place:  # else it stays where a person has put it
            self._place = place
            imgui.SetNextWindowPos(imgui.Vec2(place.x, place.y))
            imgui.SetNextWindowSize(imgui.Vec2(place.width, place.height))
        expanded, self._open = imgui.Begin(self._options.title, self._open)
        if expanded:
            self._draw_controls()
            if self._facts is not None:
                _draw_facts(self._facts, list(self._history))
            if imgui.CollapsingHeader("View"):
                self._draw_view()
        imgui.End()

    def _draw_controls(self) -> None:
        if self._is_over:
            imgui.TextUnformatted("The run is over: this is its last state.")
        if self._num_envs > 1:
            changed, chosen = imgui.InputInt("environment", self.controls.env_id)
            if changed:
                self._choose(chosen)
        imgui.BeginDisabled(self._is_over)
        if imgui.Button("Resume" if self.controls.paused else "Pause", _BUTTON):
            self.pause()
        imgui.SetItemTooltip("Space" if self._operators is None else "Esc")
        imgui.SameLine()
        if imgui.Button("Step", _BUTTON):
            self._step()
        key = "Right arrow: " if self._operators is None else ""
        imgui.SetItemTooltip(f"{key}one control step, then a pause")
        imgui.SameLine()
        imgui.BeginDisabled(not self._options.resets)
        if imgui.Button("Reset", _BUTTON):
            self._reset()
        imgui.EndDisabled()
        imgui.SetItemTooltip("Backspace: this environment's episode ends, as truncated")
        names = ["as fast as possible", *(f"{speed:g} x real time" for speed in SPEEDS if speed)]
        changed, chosen = imgui.Combo("speed", SPEEDS.index(self.controls.speed), names)
        if changed:
            self._change(speed=SPEEDS[chosen])
        imgui.EndDisabled()

    def _draw_view(self) -> None:
        """Draw Studio's widgets for cameras and view options."""
        viewer = self.viewer
        ux.camera_selection_gui(viewer.model, viewer.data, viewer.camera, self._camera)
        if imgui.TreeNodeEx("Rendering"):
            ux.rendering_gui(viewer.model, viewer.vis_options, viewer.render_flags)
            imgui.TreePop()
        if imgui.TreeNodeEx("Groups"):
            ux.groups_gui(viewer.model, viewer.vis_options)
            imgui.TreePop()
        if imgui.TreeNodeEx("Visualization"):
            ux.visualization_gui(viewer.model, viewer.vis_options, viewer.camera)
            imgui.TreePop()


def _draw_facts(facts: Facts, history: list[Facts]) -> None:
    """Draw lines, a table of reward terms, and a plot of their latest values."""
    imgui.TextUnformatted(f"step {facts.step}   {facts.seconds:.2f} s of the episode")
    for name, text in facts.lines:
        imgui.TextUnformatted(f"{name} {text}")
    if not facts.rewards:
        return
    imgui.SeparatorText("Rewards per term")
    flags = int(imgui.TableFlags.RowBg) | int(imgui.TableFlags.SizingStretchProp)
    if imgui.BeginTable("rewards", 3, flags):
        for name in ("term", "step", "episode"):
            imgui.TableSetupColumn(name)
        imgui.TableHeadersRow()
        for name, value in facts.rewards.items():
            imgui.TableNextRow()
            for text in (name, signed_number(value), signed_number(facts.sums.get(name, 0.0))):
                imgui.TableNextColumn()
                imgui.TextUnformatted(text)
        imgui.EndTable()
    implot.SetNextAxesToFit()
    # A legend below the panel's end, or above its top, would be drawn outside of the panel.
    top = imgui.GetCursorPosY() - imgui.GetScrollY()
    bottom = top + _LEGEND_MARGIN + _LEGEND_LINE * len(facts.rewards)
    has_legend = top > 0.0 and bottom < imgui.GetWindowHeight()
    flags = 0 if has_legend else int(implot.Flags.NoLegend)
    if implot.BeginPlot("##rewards", imgui.Vec2(-1.0, _PLOT_HEIGHT), flags):
        implot.SetupAxes("control step", "")
        steps = [past.step for past in history]
        for name in facts.rewards:
            implot.PlotLine(name, steps, [past.rewards.get(name, 0.0) for past in history])
        implot.EndPlot()


if __name__ == "__main__":
    run = ProcessId.parse(sys.argv[2])
    if run is not None:
        end_with(run)
    main(int(sys.argv[1]))
