"""`NativeOperator`: teleoperation in MuJoCo's window, with keys, a gamepad and the mouse.

The window reports that keys are pressed, but not that they are released: each press moves the tool
by a short way, at its usual speed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from embodichain.lab.gym.teleop import Teleop, ToolCommand
from embodichain.recording.viewers.operators.teleop_input import OperatorInput
from embodichain.utils.errors import ConfigError, EmbodichainError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.sim.engine.api import F64

__all__ = ["NativeOperator", "Pad", "Window", "read_gamepad"]

_STEP = 0.02
"""Distance in metres that a press of a key moves the tool."""
_TURN = np.deg2rad(5.0)
"""Angle in radians that a press of a key turns the tool."""
_MAX_PRESSES = 3
"""Number of presses that are remembered, so that the tool stops soon after the last one."""
_POLL_SECONDS = 0.02
_MAX_DELAY = 0.1
"""Seconds that steps may lag behind real time before the lag is given up."""
Pad = Callable[[], tuple[list[float], list[int]] | None]
"""Returns the sticks' axes and the pressed buttons of a gamepad, as browsers number them."""
_BUTTONS = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 8, 7: 9, 11: 12, 12: 15, 13: 13, 14: 14}
"""Button of GLFW to the same button in a browser's standard mapping."""


class Window(Protocol):
    """What an operator needs of MuJoCo's window (`NativeViewer`)."""

    on_key: Callable[[int], None] | None

    @property
    def is_running(self) -> bool:
        """Whether the user has the window open."""
        ...

    @property
    def dragged(self) -> tuple[int, F64] | None:
        """The body that is dragged with the mouse, and how far, (3,) in metres; or None."""
        ...


def read_gamepad() -> tuple[list[float], list[int]] | None:
    """Read the first gamepad that GLFW has a mapping of; None if there is none."""
    import glfw

    state: Any = glfw.get_gamepad_state(glfw.JOYSTICK_1)
    if state is None:
        return None
    buttons = [button for glfw_button, button in _BUTTONS.items() if state.buttons[glfw_button]]
    return list(state.axes[:4]), buttons


class NativeOperator:
    """An `Operator` at MuJoCo's window, in real time.

    Args:
        env: The environment; its window is open.
        teleop: Its policy, bound to it.
        stopped: Whether the run was stopped.
        pad: Reads a gamepad.
        window: The window; None is that of the environment.

    Raises:
        ConfigError: If there is no window.
    """

    def __init__(
        self,
        env: ObservedEnv,
        teleop: Teleop,
        stopped: Callable[[], bool] = lambda: False,
        pad: Pad = read_gamepad,
        window: Window | None = None,
    ) -> None:
        window = window or env.sim.window
        if window is None:
            message = "teleop needs a viewer; there is no display for viewer=native: use viewer=web"
            raise ConfigError([Problem("viewer", message)])
        self._env = env
        self._teleop = teleop
        self._stopped = stopped
        self._pad = pad
        self._window = window
        self._input = OperatorInput()
        self._keys: SimpleQueue[int] = SimpleQueue()  # filled on the window's thread
        self._remaining = np.zeros(6)  # m and rad that pressed keys still ask for
        self._next_step = 0.0  # in seconds of the monotonic clock
        window.on_key = self._keys.put

    def command(self, begins: bool) -> ToolCommand:
        """Return the present command; an episode begins with the first key.

        Raises:
            EmbodichainError: If the window was closed.
        """
        before = self._read()
        if begins:
            self._remaining[:] = 0.0
            self._wait_for_input(before)
        self._wait_for_step()
        devices = self._read()
        velocity = np.array([*devices.linear, *devices.angular]) + self._take_step(devices.speed)
        x, y, z, rx, ry, rz = np.clip(velocity, -1.0, 1.0).tolist()
        return replace(devices, linear=(x, y, z), angular=(rx, ry, rz))

    def _wait_for_input(self, before: ToolCommand) -> None:
        """Wait until a key is pressed, another device changes, or the run is stopped."""
        while not self._remaining.any() and self._read() == before and not self._stopped():
            time.sleep(_POLL_SECONDS)

    def _wait_for_step(self) -> None:
        """Wait for the next step in real time."""
        now = time.monotonic()
        self._next_step = max(self._next_step + self._env.step_dt, now - _MAX_DELAY)
        time.sleep(max(0.0, self._next_step - now))

    def _take_step(self, speed: float) -> F64:
        """Return (6,) shares of the largest velocities for pressed keys; less of them remains."""
        largest = np.repeat([self._teleop.linear_speed, self._teleop.angular_speed], 3)
        largest_step = largest * (speed * self._env.step_dt)
        share: F64 = np.clip(self._remaining / largest_step, -1.0, 1.0)
        self._remaining -= share * largest_step
        return share

    def _read(self) -> ToolCommand:
        """Read all devices; return the command without the motion that pressed keys ask for."""
        if not self._window.is_running:
            raise EmbodichainError("the window was closed, so the robot can no longer be operated")
        while True:
            try:
                self._press(self._keys.get_nowait())
            except Empty:
                break
        axes, buttons = self._pad() or ([], [])
        self._input.hold(axes=axes, buttons=buttons)
        self._input.goal = None
        dragged = self._window.dragged  # once: the window's thread changes it
        if dragged is not None:
            body, way = dragged
            if body in self._robot_bodies():
                x, y, z = (self._teleop.tool_pose()[0] + way).tolist()
                self._input.goal = (x, y, z)
        return self._input.command()

    def _press(self, key: int) -> None:
        """Add the motion of a pressed key to what remains, or do its action."""
        move = self._input.press_native(key)
        if move is not None:
            size = _STEP if move.axis < 3 else _TURN
            most = _MAX_PRESSES * size
            remaining = self._remaining[move.axis] + move.sign * size
            self._remaining[move.axis] = min(max(remaining, -most), most)

    def _robot_bodies(self) -> set[int]:
        """MuJoCo ids of the bodies of the robot that moves."""
        uid = self._teleop.robot_uid
        if uid is None or uid not in self._env.sim.robots:
            return set()
        return set(map(int, self._env.sim.robots[uid].index.body_ids))
