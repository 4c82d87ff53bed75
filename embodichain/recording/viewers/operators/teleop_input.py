"""What keys, gamepads and the mouse mean: `OperatorInput` makes a `ToolCommand` of them.

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
SMALLEST_SPEED, LARGEST_SPEED = 0.1, 4.0
"""Range of the speed's factor that an operator can choose."""
_DEAD_ZONE = 0.15
"""Deflections of a stick below this are none."""
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
        codes, native, shown, meaning: As of `Move`.
        button: Button of a gamepad with the standard mapping of browsers; -1 for none.
    """

    action: str
    codes: tuple[str, ...]
    native: tuple[int, ...]
    button: int
    shown: str
    meaning: str


MOVES = (
    Move(0, 1, ("KeyW", "ArrowUp"), (265,), "W  \u2191", "forward (+x)"),
    Move(0, -1, ("KeyS", "ArrowDown"), (264,), "S  \u2193", "back"),
    Move(1, 1, ("KeyA", "ArrowLeft"), (263,), "A  \u2190", "left (+y)"),
    Move(1, -1, ("KeyD", "ArrowRight"), (262,), "D  \u2192", "right"),
    Move(2, 1, ("KeyE", "PageUp"), (266,), "E  PgUp", "up (+z)"),
    Move(2, -1, ("KeyQ", "PageDown"), (267,), "Q  PgDn", "down"),
    Move(5, 1, ("KeyJ",), (324,), "J", "turn left about z"),
    Move(5, -1, ("KeyL",), (326,), "L", "turn right about z"),
    Move(4, 1, ("KeyI",), (328,), "I", "turn about y"),
    Move(4, -1, ("KeyK",), (322,), "K", "turn back about y"),
    Move(3, 1, ("KeyO",), (329,), "O", "turn about x"),
    Move(3, -1, ("KeyU",), (327,), "U", "turn back about x"),
)
"""In MuJoCo's window: arrows, page up and down, and on the keypad 4/6, 8/2, 9/7 to turn."""
PRESSES = (
    Press("grips", ("Space",), (32,), 0, "Space", "open or close the gripper"),
    Press("ends", ("Enter", "NumpadEnter"), (257, 335), 9, "Enter", "done: end the episode"),
    Press("discards", ("Backspace",), (259,), 8, "Backspace", "discard the episode"),
    Press("axes", ("KeyT",), (325,), 2, "T", "world axes or the tool's"),
    Press("switches", ("Tab",), (320,), 3, "Tab", "the next arm"),
    Press("pause", ("Escape",), (), -1, "Esc", "pause"),
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
_BY_CODE = {code: move for move in MOVES for code in move.codes}
_PRESS_BY_CODE = {code: press for press in PRESSES for code in press.codes}
CODES = (*_BY_CODE, *_PRESS_BY_CODE, *_SLOW_KEYS)
"""All keys of the page."""
_PRESS_BY_NATIVE = {key: press for press in PRESSES for key in press.native}
_PRESS_BY_BUTTON = {press.button: press for press in PRESSES if press.button >= 0}
_MOVE_BY_NATIVE = {key: move for move in MOVES for key in move.native}
_STICKS = ((0, 1, -1.0), (1, 0, -1.0), (2, 3, -1.0), (5, 2, -1.0))
"""Axis of the tool, axis of the gamepad, sign: sticks to the right and down are positive."""
_CROSS = {12: (4, 1.0), 13: (4, -1.0), 14: (3, -1.0), 15: (3, 1.0)}


def key_help() -> list[tuple[str, str]]:
    """The keys of the page and their meanings."""
    held = [(move.shown, move.meaning) for move in MOVES]
    return [*held, ("Shift", "slow, while held"), *((p.shown, p.meaning) for p in PRESSES)]


class OperatorInput:
    """The state of an operator's devices.

    Attributes:
        goal: Position to which the mouse drags the tool, or None.
        pauses: How often the key for a pause was pressed.
    """

    def __init__(self) -> None:
        self.goal: Vector | None = None
        self.pauses = 0
        self._held: frozenset[str] = frozenset()
        self._axes: tuple[float, ...] = ()
        self._buttons: frozenset[int] = frozenset()
        self._speed = 1.0
        self._counts = ToolCommand()

    def hold(
        self,
        codes: Iterable[str] = (),
        axes: Sequence[float] = (),
        buttons: Iterable[int] = (),
        speed: float = 1.0,
    ) -> None:
        """Set what is held at present.

        Args:
            codes: Keys of a browser; unknown ones do nothing.
            axes: Deflections of a gamepad's sticks, in [-1, 1]: left x, y, right x, y.
            buttons: Its buttons that are held.
            speed: Factor of the speed, clamped to `SMALLEST_SPEED` and `LARGEST_SPEED`.
        """
        down = frozenset(buttons)
        for button in down - self._buttons:
            self._act(_PRESS_BY_BUTTON.get(button))
        self._held, self._axes, self._buttons = frozenset(codes), tuple(axes), down
        self._speed = min(max(speed, SMALLEST_SPEED), LARGEST_SPEED)

    def release(self) -> None:
        """Nothing is held any more."""
        self._held, self._axes, self.goal = frozenset(), (), None

    def press(self, code: str) -> None:
        """A key of a browser was pressed."""
        self._act(_PRESS_BY_CODE.get(code))

    def press_native(self, key: int) -> Move | None:
        """A key of MuJoCo's window was pressed; returns the motion that it asks for."""
        self._act(_PRESS_BY_NATIVE.get(key))
        return _MOVE_BY_NATIVE.get(key)

    def act(self, action: str) -> None:
        """Act as the key of an action of `PRESSES`."""
        self._act(next(press for press in PRESSES if press.action == action))

    def command(self) -> ToolCommand:
        """The command for what is held, with the counts of what was pressed."""
        motion = [0.0] * 6
        for move in {_BY_CODE[code] for code in self._held if code in _BY_CODE}:
            motion[move.axis] += move.sign
        for axis, stick, sign in _STICKS:
            if stick < len(self._axes):
                motion[axis] += sign * _deflection(self._axes[stick])
        for button in self._buttons & _CROSS.keys():
            axis, sign = _CROSS[button]
            motion[axis] += sign
        slow = self._held.intersection(_SLOW_KEYS) or _SLOW_BUTTON in self._buttons
        x, y, z, rx, ry, rz = (min(max(value, -1.0), 1.0) for value in motion)
        return replace(
            self._counts,
            linear=(x, y, z),
            angular=(rx, ry, rz),
            speed=self._speed * (SLOW if slow else 1.0),
            goal=self.goal,
        )

    def _act(self, press: Press | None) -> None:
        if press is None:
            return
        if press.action == "pause":
            self.pauses += 1
        elif press.action == "axes":
            world = self._counts.axes == "world"
            self._counts = replace(self._counts, axes="tool" if world else "world")
        else:
            count = getattr(self._counts, press.action) + 1
            self._counts = replace(self._counts, **{press.action: count})


def _deflection(value: float) -> float:
    """A stick's deflection beyond its dead zone, in [-1, 1]; 0 for what is not a number."""
    if not math.isfinite(value) or abs(value) < _DEAD_ZONE:
        return 0.0
    share = (min(abs(value), 1.0) - _DEAD_ZONE) / (1.0 - _DEAD_ZONE)
    return math.copysign(share, value)
