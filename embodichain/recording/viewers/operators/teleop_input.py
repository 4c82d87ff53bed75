"""Keys, gamepads and the mouse: `OperatorInput` makes a `ToolCommand` of them.

The web page and MuJoCo's window share this table; each has its own names of keys.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

from embodichain.lab.gym.teleop import ToolCommand, Vector

__all__ = [
    "CODES",
    "LARGEST_SPEED",
    "MOVES",
    "PAD_HELP",
    "PRESSES",
    "SLOW",
    "SMALLEST_SPEED",
    "Move",
    "OperatorInput",
    "Press",
    "key_help",
]

SLOW = 0.2
"""Factor of the speed while the key for slow motion is held."""
SMALLEST_SPEED = 0.1
"""Smallest factor of the speed that an operator can choose."""
LARGEST_SPEED = 4.0
"""Largest factor of the speed that an operator can choose."""
_DEAD_ZONE = 0.15
"""Deflections of a stick below this count as 0."""
_SLOW_KEYS = ("ShiftLeft", "ShiftRight")
_SLOW_BUTTON = 5


class Move(NamedTuple):
    """A key that moves the tool while it is held.

    Attributes:
        axis: 0 to 2 move along x, y, z; 3 to 5 rotate about them.
        sign: 1 or -1.
        codes: Keys of a browser (`KeyboardEvent.code`).
        native: Keys of MuJoCo's window (codes of GLFW).
        shown: The keys, for people.
        meaning: The motion, in world axes, as seen from the robot.
    """

    axis: int
    sign: int
    codes: tuple[str, ...]
    native: tuple[int, ...]
    shown: str
    meaning: str


class Press(NamedTuple):
    """A key that acts when it is pressed.

    Attributes:
        action: A counter of `ToolCommand`, ``axes`` or ``pause``.
        codes: As of `Move`.
        native: As of `Move`.
        button: Button of a gamepad with the standard mapping of browsers; -1 for none.
        shown: As of `Move`.
        meaning: What the key does.
    """

    action: str
    codes: tuple[str, ...]
    native: tuple[int, ...]
    button: int
    shown: str
    meaning: str


MOVES = (
    Move(
        axis=0,
        sign=1,
        codes=("KeyW", "ArrowUp"),
        native=(265,),
        shown="W  \u2191",
        meaning="forward (+x)",
    ),
    Move(
        axis=0,
        sign=-1,
        codes=("KeyS", "ArrowDown"),
        native=(264,),
        shown="S  \u2193",
        meaning="back",
    ),
    Move(
        axis=1,
        sign=1,
        codes=("KeyA", "ArrowLeft"),
        native=(263,),
        shown="A  \u2190",
        meaning="left (+y)",
    ),
    Move(
        axis=1,
        sign=-1,
        codes=("KeyD", "ArrowRight"),
        native=(262,),
        shown="D  \u2192",
        meaning="right",
    ),
    Move(
        axis=2,
        sign=1,
        codes=("KeyE", "PageUp"),
        native=(266,),
        shown="E  PgUp",
        meaning="up (+z)",
    ),
    Move(
        axis=2,
        sign=-1,
        codes=("KeyQ", "PageDown"),
        native=(267,),
        shown="Q  PgDn",
        meaning="down",
    ),
    Move(
        axis=5,
        sign=1,
        codes=("KeyJ",),
        native=(324,),
        shown="J",
        meaning="turn left about z",
    ),
    Move(
        axis=5,
        sign=-1,
        codes=("KeyL",),
        native=(326,),
        shown="L",
        meaning="turn right about z",
    ),
    Move(
        axis=4,
        sign=1,
        codes=("KeyI",),
        native=(328,),
        shown="I",
        meaning="turn about y",
    ),
    Move(
        axis=4,
        sign=-1,
        codes=("KeyK",),
        native=(322,),
        shown="K",
        meaning="turn back about y",
    ),
    Move(
        axis=3,
        sign=1,
        codes=("KeyO",),
        native=(329,),
        shown="O",
        meaning="turn about x",
    ),
    Move(
        axis=3,
        sign=-1,
        codes=("KeyU",),
        native=(327,),
        shown="U",
        meaning="turn back about x",
    ),
)
"""In MuJoCo's window: arrows, page up and down, and on the keypad 4/6, 8/2, 9/7 to turn."""
PRESSES = (
    Press(
        action="grips",
        codes=("Space",),
        native=(32,),
        button=0,
        shown="Space",
        meaning="open or close the gripper",
    ),
    Press(
        action="ends",
        codes=("Enter", "NumpadEnter"),
        native=(257, 335),
        button=9,
        shown="Enter",
        meaning="done: end the episode",
    ),
    Press(
        action="discards",
        codes=("Backspace",),
        native=(259,),
        button=8,
        shown="Backspace",
        meaning="discard the episode",
    ),
    Press(
        action="axes",
        codes=("KeyT",),
        native=(325,),
        button=2,
        shown="T",
        meaning="world axes or the tool's",
    ),
    Press(
        action="switches",
        codes=("Tab",),
        native=(320,),
        button=3,
        shown="Tab",
        meaning="the next arm",
    ),
    Press(
        action="pause",
        codes=("Escape",),
        native=(),
        button=-1,
        shown="Esc",
        meaning="pause",
    ),
)
"""In MuJoCo's window: keypad 5 changes axes, keypad 0 the arm."""
PAD_HELP = (
    ("left stick", "forward, back, left, right"),
    ("right stick", "up, down, turn about z"),
    ("cross", "turn about x, y"),
    ("A", "open or close the gripper"),
    ("RB", "slow, while held"),
    ("X, Y", "axes, arm"),
    ("start, back", "done, discard"),
)
_MOVE_BY_CODE = {code: move for move in MOVES for code in move.codes}
_PRESS_BY_CODE = {code: press for press in PRESSES for code in press.codes}
CODES = (*_MOVE_BY_CODE, *_PRESS_BY_CODE, *_SLOW_KEYS)
"""All keys of the page."""
_PRESS_BY_NATIVE = {key: press for press in PRESSES for key in press.native}
_PRESS_BY_BUTTON = {press.button: press for press in PRESSES if press.button >= 0}
_MOVE_BY_NATIVE = {key: move for move in MOVES for key in move.native}


class _ToolAxis(NamedTuple):
    """What a stick or a button of a gamepad moves.

    Attributes:
        axis: As of `Move`.
        sign: 1 or -1.
    """

    axis: int
    sign: float


# A gamepad's axes are positive to the right and down.
_STICKS = {
    1: _ToolAxis(axis=0, sign=-1.0),
    0: _ToolAxis(axis=1, sign=-1.0),
    3: _ToolAxis(axis=2, sign=-1.0),
    2: _ToolAxis(axis=5, sign=-1.0),
}
"""Axis of a gamepad: left x, y, right x, y."""
_CROSS = {
    12: _ToolAxis(axis=4, sign=1.0),
    13: _ToolAxis(axis=4, sign=-1.0),
    14: _ToolAxis(axis=3, sign=-1.0),
    15: _ToolAxis(axis=3, sign=1.0),
}
"""Button of a gamepad: up, down, left, right of its cross."""


def key_help() -> list[tuple[str, str]]:
    """The keys of the page and their meanings."""
    lines = [(move.shown, move.meaning) for move in MOVES]
    lines.append(("Shift", "slow, while held"))
    lines += [(press.shown, press.meaning) for press in PRESSES]
    return lines


class OperatorInput:
    """The state of an operator's devices.

    Attributes:
        goal: Position to which the mouse drags the tool, or None.
        pauses: How often the key for a pause was pressed.
    """

    def __init__(self) -> None:
        self.goal: Vector | None = None
        self.pauses = 0
        self._keys: frozenset[str] = frozenset()
        self._axes: tuple[float, ...] = ()
        self._buttons: frozenset[int] = frozenset()
        self._speed = 1.0
        self._counts = ToolCommand()  # without motion: the counts of presses, and the axes

    def hold(
        self,
        codes: Iterable[str] = (),
        axes: Sequence[float] = (),
        buttons: Iterable[int] = (),
        speed: float = 1.0,
    ) -> None:
        """Set the state of devices: the keys and buttons that are held, and the sticks.

        Args:
            codes: Keys of a browser; unknown ones do nothing.
            axes: Deflections of a gamepad's sticks, in [-1, 1]: left x, y, right x, y.
            buttons: Its buttons that are held.
            speed: Factor of the speed, clamped to `SMALLEST_SPEED` and `LARGEST_SPEED`.
        """
        pressed = frozenset(buttons)
        for button in pressed - self._buttons:
            if button in _PRESS_BY_BUTTON:
                self.act(_PRESS_BY_BUTTON[button].action)
        self._keys = frozenset(codes)
        self._axes = tuple(axes)
        self._buttons = pressed
        self._speed = min(max(speed, SMALLEST_SPEED), LARGEST_SPEED)

    def release(self) -> None:
        """Release keys, sticks and mouse.

        Buttons stay: one that is still held at the next message was not pressed again.
        """
        self._keys = frozenset()
        self._axes = ()
        self.goal = None

    def press(self, code: str) -> None:
        """Act as the key of a browser that was pressed, if it has an action."""
        if code in _PRESS_BY_CODE:
            self.act(_PRESS_BY_CODE[code].action)

    def press_native(self, key: int) -> Move | None:
        """Act as the key of MuJoCo's window that was pressed, or return the motion it asks for."""
        if key in _PRESS_BY_NATIVE:
            self.act(_PRESS_BY_NATIVE[key].action)
        return _MOVE_BY_NATIVE.get(key)

    def act(self, action: str) -> None:
        """Act as the key of an action of `PRESSES`."""
        if action == "pause":
            self.pauses += 1
        elif action == "axes":
            is_world = self._counts.axes == "world"
            self._counts = replace(self._counts, axes="tool" if is_world else "world")
        else:
            count = getattr(self._counts, action) + 1
            self._counts = replace(self._counts, **{action: count})

    def command(self) -> ToolCommand:
        """The command for the devices' state, with the counts of presses."""
        motion = [0.0] * 6
        # As a set: two keys of the same motion, such as W and the arrow, move once.
        for move in {_MOVE_BY_CODE[code] for code in self._keys if code in _MOVE_BY_CODE}:
            motion[move.axis] += move.sign
        for stick, tool_axis in _STICKS.items():
            if stick < len(self._axes):
                motion[tool_axis.axis] += tool_axis.sign * _deflection(self._axes[stick])
        for button in self._buttons & _CROSS.keys():
            tool_axis = _CROSS[button]
            motion[tool_axis.axis] += tool_axis.sign
        speed = self._speed
        if self._keys.intersection(_SLOW_KEYS) or _SLOW_BUTTON in self._buttons:
            speed *= SLOW
        x, y, z, rx, ry, rz = (min(max(value, -1.0), 1.0) for value in motion)
        return replace(
            self._counts,
            linear=(x, y, z),
            angular=(rx, ry, rz),
            speed=speed,
            goal=self.goal,
        )


def _deflection(value: float) -> float:
    """A stick's deflection beyond its dead zone, in [-1, 1]; 0 if it is not finite."""
    if not math.isfinite(value) or abs(value) < _DEAD_ZONE:
        return 0.0
    size = (min(abs(value), 1.0) - _DEAD_ZONE) / (1.0 - _DEAD_ZONE)
    return math.copysign(size, value)
