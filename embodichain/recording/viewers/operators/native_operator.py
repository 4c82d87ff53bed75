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

_STEP, _TURN = 0.02, np.deg2rad(5.0)
"""M and rad that a press of a key moves the tool."""
_AHEAD = 3
"""Presses that are remembered at most, so that the tool stops soon after the last one."""
_NAP = 0.02
_LATE = 0.1
Pad = Callable[[], tuple[list[float], list[int]] | None]
"""Returns the sticks' axes and the pressed buttons of a gamepad, as browsers number them."""
_BUTTONS = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 8, 7: 9, 11: 12, 12: 15, 13: 13, 14: 14}
"""Button of GLFW to the same of a browser's standard mapping."""


class Window(Protocol):
    """What an operator needs of MuJoCo's window (`NativeViewer`)."""

    on_key: Callable[[int], None] | None

    @property
    def is_running(self) -> bool:
        """Whether the user has the window open."""
        ...

    @property
    def dragged(self) -> tuple[int, F64] | None:
        """The body that is dragged with the mouse, and metres (3,) to where; or None."""
        ...


def read_gamepad() -> tuple[list[float], list[int]] | None:
    """Read the first gamepad that GLFW has a mapping of; None if there is none."""
    import glfw

    state: Any = glfw.get_gamepad_state(glfw.JOYSTICK_1)
    if state is None:
        return None
    buttons = [ours for theirs, ours in _BUTTONS.items() if state.buttons[theirs]]
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
        found = window or env.sim.window
        if found is None:
            message = "teleop needs a viewer; there is no display for viewer=native: use viewer=web"
            raise ConfigError([Problem("viewer", message)])
        self._env, self._teleop, self._stopped, self._pad = env, teleop, stopped, pad
        self._window, self._input = found, OperatorInput()
        self._keys: SimpleQueue[int] = SimpleQueue()  # filled on the window's thread
        self._way = np.zeros(6)  # m and rad that pressed keys still ask for
        self._due = 0.0
        found.on_key = self._keys.put

    def command(self, begins: bool) -> ToolCommand:
        """Return the present command; an episode begins with the first key.

        Raises:
            EmbodichainError: If the window was closed.
        """
        before = self._read()
        if begins:
            self._way[:] = 0.0
        while begins and not self._way.any() and self._read() == before and not self._stopped():
            time.sleep(_NAP)
        now = time.monotonic()
        self._due = max(self._due + self._env.step_dt, now - _LATE)
        time.sleep(max(0.0, self._due - now))
        held = self._read()
        share = self._walk(held.speed)
        moved = np.array([*held.linear, *held.angular]) + share
        x, y, z, rx, ry, rz = np.clip(moved, -1.0, 1.0).tolist()
        return replace(held, linear=(x, y, z), angular=(rx, ry, rz))

    def _walk(self, speed: float) -> F64:
        """(6,) shares of the largest velocities for the way of pressed keys; it gets shorter."""
        largest = np.repeat([self._teleop.linear_speed, self._teleop.angular_speed], 3)
        step = largest * (speed * self._env.step_dt)
        share: F64 = np.clip(self._way / step, -1.0, 1.0)
        self._way -= share * step
        return share

    def _read(self) -> ToolCommand:
        """Read all devices; returns the command of what is held, without pressed keys."""
        if not self._window.is_running:
            raise EmbodichainError("the window was closed, so the robot can no longer be operated")
        while True:
            try:
                self._take(self._keys.get_nowait())
            except Empty:
                break
        axes, buttons = self._pad() or ([], [])
        self._input.hold((), axes, buttons)
        self._input.goal = None
        dragged = self._window.dragged
        if dragged is not None and dragged[0] in self._robot_bodies():
            x, y, z = (self._teleop.tool_pose()[0] + dragged[1]).tolist()
            self._input.goal = (x, y, z)
        return self._input.command()

    def _take(self, key: int) -> None:
        move = self._input.press_native(key)
        if move is not None:
            size = _STEP if move.axis < 3 else _TURN
            most = _AHEAD * size
            way = self._way[move.axis] + move.sign * size
            self._way[move.axis] = min(max(way, -most), most)

    def _robot_bodies(self) -> set[int]:
        """MuJoCo ids of the bodies of the robot that moves."""
        uid = self._teleop.robot_uid
        robot = None if uid is None else self._env.sim.robots.get(uid)
        return set() if robot is None else set(map(int, robot.entity.body_ids))
