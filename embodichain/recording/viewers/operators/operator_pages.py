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


class View(NamedTuple):
    """A perspective camera: positions in the environment to points of the picture and back.

    Points (u, v) are in half heights of the picture, from its middle, to the right and up.

    Attributes:
        eye: (3,) position, m.
        forward, up, right: (3,) unit vectors.
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
        scale = self.slope * (depth if depth > 1e-6 else 1e-6)
        return float(ray @ self.right) / scale, float(ray @ self.up) / scale, depth

    def position(self, u: float, v: float, depth: float) -> F64:
        """The position of a point at a depth."""
        side: F64 = u * self.right + v * self.up
        return self.eye + depth * (self.forward + self.slope * side)


def view_of(
    model: mujoco.MjModel, data: mujoco.MjData, camera: mujoco.MjvCamera, scene: mujoco.MjvScene
) -> View:
    """The view of a camera; a `mujoco.MjvScene` of the model is used for the calculation."""
    mujoco.mjv_updateCamera(model, data, camera, scene)
    eyes = scene.camera  # two, for stereo; a picture is drawn from between them
    eye = 0.5 * (np.array(eyes[0].pos, np.float64) + np.array(eyes[1].pos, np.float64))
    forward, up = np.array(eyes[0].forward, np.float64), np.array(eyes[0].up, np.float64)
    height = 0.5 * (eyes[0].frustum_top - eyes[0].frustum_bottom)
    slope = float(height / eyes[0].frustum_near)
    return View(eye, forward, up, np.cross(forward, up), slope)


def look_like(model: mujoco.MjModel, camera: mujoco.MjvCamera, name: str) -> None:
    """Place a free camera so that it shows what a camera of the model shows; else do nothing."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
    if index < 0 or model.cam_bodyid[index] != 0:
        return
    eye, axes = model.cam_pos[index], quat_to_matrix(model.cam_quat[index])
    forward = -axes[:, 2]
    distance = max(float((model.stat.center - eye) @ forward), 0.1)
    slopes = np.tan(np.deg2rad([model.cam_fovy[index], model.vis.global_.fovy]) / 2.0)
    camera.lookat[:] = eye + distance * forward
    camera.distance = distance * float(slopes[0] / slopes[1])
    camera.azimuth = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
    camera.elevation = float(np.rad2deg(np.arcsin(np.clip(forward[2], -1.0, 1.0))))


class _Grab(NamedTuple):
    """A drag: depth of the tool when it began, and the tool's point relative to the mouse's."""

    depth: float
    offset: tuple[float, float]


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
        self._away = False
        self._heard = -math.inf
        self._input = OperatorInput()
        self._grab: _Grab | None = None
        self._status: dict[str, Any] = {}
        self._tool: F64 | None = None
        self.view: View | None = None

    @property
    def operated(self) -> bool:
        """Whether a person is there."""
        heard = time.monotonic() - self._heard < _LOST_SECONDS
        return bool(self._pages) and heard and not self._away

    @property
    def command(self) -> ToolCommand:
        """The operator's command; nothing moves half a second after the page's last message."""
        if time.monotonic() - self._heard > _STALE_SECONDS:
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
                if self._pages[0] is socket and not self._take(message):
                    await socket.close(1008, "not a message of this page")
                    break
        finally:
            sender.cancel()
            first = self._pages[0] is socket
            self._pages.remove(socket)
            if first:
                self._begin()

    def _begin(self) -> None:
        """Another page operates once it is heard, or none does: nothing is held."""
        self._input.release()
        self._grab, self._away, self._heard = None, False, -math.inf
        self._changed.set()

    async def _send(self, socket: Any) -> None:
        hello = {"keys": key_help(), "pad": PAD_HELP, "codes": CODES}
        await socket.send(json.dumps({"hello": hello}))
        last: Any = None
        while True:
            message = {**self._status, "operator": self._pages[0] is socket, "handle": self._handle}
            if message != last:
                last = message
                await socket.send(json.dumps(message))
            await asyncio.sleep(_SEND_SECONDS)

    @property
    def _handle(self) -> tuple[float, float] | None:
        """(u, v) of the tool in the picture."""
        view, tool = self.view, self._tool
        if view is None or tool is None:
            return None
        u, v, depth = view.point(tool)
        return (round(u, 4), round(v, 4)) if depth > 0 else None

    # -- messages ------------------------------------------------------------------------------

    def _take(self, message: str | bytes) -> bool:
        """Take a message of the operator's page; whether it is one."""
        try:
            if not isinstance(message, str) or len(message) > _LARGEST_MESSAGE:
                return False
            given = json.loads(message)
            if "press" in given:
                self._input.press(str(given["press"]))
            else:
                axes = [float(value) for value in given["axes"]]
                buttons = [int(value) for value in given["buttons"]]
                speed = float(given["speed"])
                drag = given["drag"]
                dragged = None if drag is None else (*map(float, drag["at"]), float(drag["depth"]))
                if not all(map(math.isfinite, (speed, *axes, *(dragged or ())))):
                    return False
                self._input.hold(map(str, given["held"]), axes, buttons, speed)
                self._drag(dragged)
                self._away = bool(given["away"])
                if self._away and len(self._pages) > 1:  # a hidden page keeps no place
                    self._pages.append(self._pages.pop(0))
                    self._begin()
                    return True
        except (KeyError, TypeError, ValueError, RecursionError):
            return False
        self._heard = time.monotonic()
        self._changed.set()
        return True

    def _drag(self, at: tuple[float, ...] | None) -> None:
        """Move the goal to where the mouse is, in the plane of the view through the tool.

        Args:
            at: (u, v) of the mouse and metres to move the tool away from the camera; or None.
        """
        view, tool = self.view, self._tool
        if at is None or view is None or tool is None:
            self._grab = self._input.goal = None
            return
        u, v, further = at
        if self._grab is None:
            tool_u, tool_v, depth = view.point(tool)
            self._grab = _Grab(depth, (tool_u - u, tool_v - v))
        depth, (du, dv) = self._grab
        x, y, z = view.position(u + du, v + dv, max(depth + further, 0.05)).tolist()
        self._input.goal = (x, y, z)
