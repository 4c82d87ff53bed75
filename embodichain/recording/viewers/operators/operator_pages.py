"""`OperatorPages`: the operator's place on the page of `viewer=web`, in the process that serves it.

Every page opens the WebSocket ``/teleop``. The first one operates, the others watch; when it goes
or is hidden, the one that waits longest takes its place. Messages are JSON. From a page:
``{"press": CODE}``, and ``{"held": [CODE], "axes": [number], "buttons": [index], "speed": number,
"drag": null or {"at": [u, v], "depth": m}, "away": bool}`` at each change and ten times a second.
To a page: `hello`, then the latest status.
"""

from __future__ import annotations

import asyncio
import json
import math
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from embodichain.lab.gym.teleop import ToolCommand
from embodichain.lab.sim.engine.api import F64
from embodichain.recording.viewers.operators.teleop_input import (
    CODES,
    PAD_HELP,
    OperatorInput,
    key_help,
)
from embodichain.utils.math import quat_to_matrix

__all__ = ["SCRIPT", "OperatorPages", "View", "look_like", "view_of"]

SCRIPT = Path(__file__).with_name("teleop_page.js")
_STALE_SECONDS = 0.5
"""Time without a message after which all keys count as released."""
_LOST_SECONDS = 2.0
"""Time without a message after which the page no longer operates, and the run waits."""
_SEND_SECONDS = 1.0 / 60.0
_LARGEST_MESSAGE = 4096
"""Characters of a message, at most."""
_LEAST_DEPTH = 0.05
"""Distance in metres from the camera to which a tool can be dragged."""


class View(NamedTuple):
    """A perspective camera: positions in the environment to points of the picture and back.

    Points (u, v) are in half heights of the picture, from its middle, to the right and up.

    Attributes:
        eye: (3,) position, m.
        forward: (3,) unit vector.
        up: (3,) unit vector.
        right: (3,) unit vector.
        slope: Half the picture's height over its distance.
    """

    eye: F64
    forward: F64
    up: F64
    right: F64
    slope: float

    def point(self, position: F64) -> tuple[float, float, float]:
        """(u, v) of a position, and its depth in m, negative behind the camera."""
        ray = position - self.eye
        depth = float(ray @ self.forward)
        scale = self.slope * max(depth, 1e-6)  # behind the camera there is no picture
        return float(ray @ self.right) / scale, float(ray @ self.up) / scale, depth

    def position(self, u: float, v: float, depth: float) -> F64:
        """The position of a point at a depth."""
        offset: F64 = u * self.right + v * self.up
        return self.eye + depth * (self.forward + self.slope * offset)


def view_of(
    model: mujoco.MjModel, data: mujoco.MjData, camera: mujoco.MjvCamera, scene: mujoco.MjvScene
) -> View:
    """The view of a camera; a `mujoco.MjvScene` of the model is used for the calculation."""
    mujoco.mjv_updateCamera(model, data, camera, scene)
    eyes = scene.camera  # two, for stereo; a picture is drawn from between them
    eye = 0.5 * (np.array(eyes[0].pos, np.float64) + np.array(eyes[1].pos, np.float64))
    forward = np.array(eyes[0].forward, np.float64)
    up = np.array(eyes[0].up, np.float64)
    half_height = 0.5 * (eyes[0].frustum_top - eyes[0].frustum_bottom)
    return View(
        eye=eye,
        forward=forward,
        up=up,
        right=np.cross(forward, up),
        slope=float(half_height / eyes[0].frustum_near),
    )


def look_like(model: mujoco.MjModel, camera: mujoco.MjvCamera, name: str) -> None:
    """Place a free camera so that it shows what a camera of the model shows; else do nothing."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
    if index < 0 or model.cam_bodyid[index] != 0:
        return
    eye = model.cam_pos[index]
    forward = -quat_to_matrix(model.cam_quat[index])[:, 2]
    distance = max(float((model.stat.center - eye) @ forward), 0.1)
    # A free camera has the model's own lens: from another distance, the scene is as large.
    slopes = np.tan(np.deg2rad([model.cam_fovy[index], model.vis.global_.fovy]) / 2.0)
    camera.lookat[:] = eye + distance * forward
    camera.distance = distance * float(slopes[0] / slopes[1])
    camera.azimuth = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
    camera.elevation = float(np.rad2deg(np.arcsin(np.clip(forward[2], -1.0, 1.0))))


class _Mouse(NamedTuple):
    """The mouse while it drags the tool.

    Attributes:
        u: Its point, as of `View`.
        v: Likewise.
        further: Distance in metres to move the tool away from the camera.
    """

    u: float
    v: float
    further: float


class _Grab(NamedTuple):
    """The beginning of a drag.

    Attributes:
        depth: Depth of the tool in metres.
        u: The tool's point relative to that of the mouse.
        v: Likewise.
    """

    depth: float
    u: float
    v: float


class OperatorPages:
    """The connected pages, the one that operates, and its command.

    The server's thread calls `handle`; others may read `command` and `operated`, and call `tell`.

    Args:
        changed: Set when a command has changed.

    Attributes:
        view: The camera of the page, for dragging; None while it is not known.
    """

    def __init__(self, changed: threading.Event) -> None:
        self._changed = changed
        self._pages: list[Any] = []  # WebSockets in the order of their arrival
        self._is_hidden = False
        self._last_message = -math.inf  # in seconds of the monotonic clock
        self._input = OperatorInput()
        self._grab: _Grab | None = None
        self._status: dict[str, Any] = {}
        self._tool: F64 | None = None
        self.view: View | None = None

    @property
    def operated(self) -> bool:
        """Whether a person has a page open and in view."""
        is_lost = time.monotonic() - self._last_message >= _LOST_SECONDS
        return bool(self._pages) and not is_lost and not self._is_hidden

    @property
    def command(self) -> ToolCommand:
        """The operator's command; nothing moves half a second after the page's last message."""
        if time.monotonic() - self._last_message > _STALE_SECONDS:
            self._input.release()
        return self._input.command()

    @property
    def pauses(self) -> int:
        """How often the key for a pause was pressed."""
        return self._input.pauses

    def tell(self, status: Mapping[str, Any]) -> None:
        """Show a status on all pages.

        Args:
            status: Plain values; ``tool`` is the tool's position (3,) and more.
        """
        self._tool = np.array(status["tool"][:3], np.float64)
        self._status = dict(status)

    def discard(self) -> None:
        """Discard the episode, as the operator's key does."""
        self._input.act("discards")
        self._changed.set()

    async def handle(self, socket: Any) -> None:
        """Serve one page until it goes."""
        self._pages.append(socket)
        if self._pages[0] is socket:
            self._begin()
        sender = asyncio.create_task(self._send(socket))
        try:
            async for message in socket:
                if self._pages[0] is socket and not self._handle_message(message):
                    await socket.close(1008, "not a message of this page")
                    break
        finally:
            sender.cancel()
            has_operated = self._pages[0] is socket
            self._pages.remove(socket)
            if has_operated:
                self._begin()

    def _begin(self) -> None:
        """Forget the page that operated; the next one operates from its first message on."""
        self._input.release()
        self._grab = None
        self._is_hidden = False
        self._last_message = -math.inf
        self._changed.set()

    async def _send(self, socket: Any) -> None:
        """Send a page the keys, then each status that differs from the last one."""
        hello = {"keys": key_help(), "pad": PAD_HELP, "codes": CODES}
        await socket.send(json.dumps({"hello": hello}))
        last: Any = None
        while True:
            message = {
                **self._status,
                "operator": self._pages[0] is socket,
                "handle": self._tool_point,
            }
            if message != last:
                last = message
                await socket.send(json.dumps(message))
            await asyncio.sleep(_SEND_SECONDS)

    @property
    def _tool_point(self) -> tuple[float, float] | None:
        """(u, v) of the tool in the picture."""
        view = self.view
        tool = self._tool
        if view is None or tool is None:
            return None
        u, v, depth = view.point(tool)
        if depth <= 0:
            return None
        return round(u, 4), round(v, 4)

    # -- messages ------------------------------------------------------------------------------

    def _handle_message(self, message: str | bytes) -> bool:
        """Apply a message of the operator's page; return whether it is one."""
        if not isinstance(message, str) or len(message) > _LARGEST_MESSAGE:
            return False
        try:
            content = json.loads(message)
            if "press" in content:
                self._input.press(str(content["press"]))
            else:
                if not self._apply_state(content):
                    return False
                if self._is_hidden and len(self._pages) > 1:  # the next page operates
                    self._pages.append(self._pages.pop(0))
                    self._begin()
                    return True
        except (KeyError, TypeError, ValueError, RecursionError):
            return False
        self._last_message = time.monotonic()
        self._changed.set()
        return True

    def _apply_state(self, content: Mapping[str, Any]) -> bool:
        """Apply the state of a page's devices; return whether all numbers are finite.

        Raises:
            KeyError: If a key is missing.
            TypeError: If a value has another type.
            ValueError: If a number cannot be read.
        """
        axes = [float(value) for value in content["axes"]]
        buttons = [int(value) for value in content["buttons"]]
        speed = float(content["speed"])
        numbers = [speed, *axes]
        mouse: _Mouse | None = None
        if content["drag"] is not None:
            u, v = content["drag"]["at"]
            mouse = _Mouse(float(u), float(v), further=float(content["drag"]["depth"]))
            numbers += mouse
        if not all(map(math.isfinite, numbers)):
            return False
        keys = [str(key) for key in content["held"]]
        self._input.hold(keys, axes=axes, buttons=buttons, speed=speed)
        self._drag(mouse)
        self._is_hidden = bool(content["away"])
        return True

    def _drag(self, mouse: _Mouse | None) -> None:
        """Move the goal to where the mouse is, in the plane of the view through the tool."""
        view = self.view
        tool = self._tool
        if mouse is None or view is None or tool is None:
            self._grab = None
            self._input.goal = None
            return
        if self._grab is None:
            tool_u, tool_v, depth = view.point(tool)
            self._grab = _Grab(depth, tool_u - mouse.u, tool_v - mouse.v)
        grab = self._grab
        depth = max(grab.depth + mouse.further, _LEAST_DEPTH)
        x, y, z = view.position(mouse.u + grab.u, mouse.v + grab.v, depth).tolist()
        self._input.goal = (x, y, z)
