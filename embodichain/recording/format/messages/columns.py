"""Columns of a state row: which of them physics writes, and their names.

Inputs (ctrl, applied forces, mocap poses...) are columns that physics reads and never writes. They
are known from a start and the writes after it, so results of physics are recorded without them.

Names are from the model: ``arm/shoulder`` for a joint with one coordinate, ``cube/free.qw`` for a
coordinate of a joint with several, ``goal.x`` for a mocap body. Units are SI and radians,
quaternions wxyz.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from embodichain.lab.sim.engine.api import F64

__all__ = ["Column", "Moved", "Ranges", "column_name", "moved_ranges", "state_columns"]

Ranges = list[tuple[int, int]]
"""Columns of a row, as half-open ranges."""

_INPUTS = frozenset(
    {
        "qfrc_applied",
        "xfrc_applied",
        "ctrl",
        "eq_active",
        "mocap_pos",
        "mocap_quat",
        "userdata",
    }
)
"""Components that physics reads and never writes."""


def moved_ranges(layout: Mapping[str, slice]) -> Ranges:
    """Columns of full rows that physics may write; at least one range, possibly empty."""
    nstate = max(columns.stop for columns in layout.values())
    keep = np.ones(nstate + 1, np.bool_)
    for name in _INPUTS & layout.keys():
        keep[layout[name]] = False
    keep[nstate] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], keep]).astype(np.int8)))
    ranges = [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
    return ranges or [(0, 0)]


class Moved:
    """The columns that physics writes; a result of physics is recorded as just these columns.

    Args:
        ranges: The columns, as ranges within full rows.

    Attributes:
        spans: Columns of full rows, and their places in results.
        width: Number of columns of a result.
        columns: (width,) columns of full rows.
    """

    def __init__(self, ranges: Sequence[tuple[int, int]]) -> None:
        self.spans: list[tuple[slice, slice]] = []
        self.width = 0
        for start, stop in ranges:
            end = self.width + stop - start
            self.spans.append((slice(start, stop), slice(self.width, end)))
            self.width = end
        self.columns = np.concatenate([np.arange(start, stop) for start, stop in ranges])

    def take(self, rows: F64) -> F64:
        """Copy the columns of (n, nstate) rows: (n, width)."""
        if len(self.spans) == 1:
            row_columns, _ = self.spans[0]
            return rows[:, row_columns].copy()
        out = np.empty((len(rows), self.width))
        for row_columns, result_columns in self.spans:
            out[:, result_columns] = rows[:, row_columns]
        return out

    def find(self, columns: slice) -> slice | None:
        """Places in results of columns of full rows; None if physics does not write them."""
        for row_columns, result_columns in self.spans:
            if row_columns.start <= columns.start and columns.stop <= row_columns.stop:
                shift = result_columns.start - row_columns.start
                return slice(columns.start + shift, columns.stop + shift)
        return None


def column_name(layout: Mapping[str, slice], column: int) -> str:
    """``qpos[3]`` for a column of a row."""
    for name, columns in layout.items():
        if columns.start <= column < columns.stop:
            return f"{name}[{column - columns.start}]"
    return f"column {column}"


class Column(NamedTuple):
    """One number of a state."""

    name: str
    unit: str
    """Empty if it has none: quaternions, flags, ctrl of actuators that are not servos."""


_QUAT = tuple((f"q{axis}", "") for axis in "wxyz")
_POSITION = tuple((axis, "m") for axis in "xyz")
_SPIN = tuple((f"w{axis}", "rad/s") for axis in "xyz")
_VELOCITY = tuple((f"v{axis}", "m/s") for axis in "xyz")
_FORCE = tuple((f"f{axis}", "N") for axis in "xyz")
_TORQUE = tuple((f"t{axis}", "N m") for axis in "xyz")

Parts = tuple[tuple[str, str], ...]
"""Name and unit of each coordinate of a joint or body."""
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_QPOS: Mapping[int, Parts] = {
    _FREE: (*_POSITION, *_QUAT),
    _BALL: _QUAT,
    _SLIDE: (("", "m"),),
    _HINGE: (("", "rad"),),
}
_QVEL: Mapping[int, Parts] = {
    _FREE: (*_VELOCITY, *_SPIN),
    _BALL: _SPIN,
    _SLIDE: (("", "m/s"),),
    _HINGE: (("", "rad/s"),),
}
_FORCES: Mapping[int, Parts] = {
    _FREE: (*_FORCE, *_TORQUE),
    _BALL: _TORQUE,
    _SLIDE: (("", "N"),),
    _HINGE: (("", "N m"),),
}
_ACCELERATIONS = {
    kind: tuple((f"a{part[1:]}" if part[:1] == "v" else part, f"{unit}^2") for part, unit in parts)
    for kind, parts in _QVEL.items()
}
# The unit of ctrl is known for position servos only.
_SERVO = {_SLIDE: "m", _HINGE: "rad"}


def state_columns(
    model: mujoco.MjModel, layout: Mapping[str, tuple[int, int]]
) -> dict[str, list[Column]]:
    """Name and unit of every column, by component; without empty components.

    Args:
        model: The recorded model.
        layout: Component of a row to its (start, stop) columns.
    """
    makers: Mapping[str, Callable[[], Iterator[Column]]] = {
        "time": lambda: iter([Column("time", "s")]),
        "qpos": lambda: _joints(model, _QPOS),
        "qvel": lambda: _joints(model, _QVEL),
        "qacc_warmstart": lambda: _joints(model, _ACCELERATIONS),
        "qfrc_applied": lambda: _joints(model, _FORCES),
        "xfrc_applied": lambda: _bodies(model, (*_FORCE, *_TORQUE), mocap=False),
        "mocap_pos": lambda: _bodies(model, _POSITION, mocap=True),
        "mocap_quat": lambda: _bodies(model, _QUAT, mocap=True),
        "act": lambda: _activations(model),
        "ctrl": lambda: _controls(model),
    }
    columns_of: dict[str, list[Column]] = {}
    for component, (start, stop) in layout.items():
        if stop <= start:
            continue
        columns: list[Column] = []
        if component in makers:
            columns = list(makers[component]())
        if len(columns) != stop - start:  # a component without names for its columns
            columns = [Column(str(i), "") for i in range(stop - start)]
        columns_of[component] = columns
    return columns_of


def _joints(model: mujoco.MjModel, parts: Mapping[int, Parts]) -> Iterator[Column]:
    for joint in range(model.njnt):
        name = model.joint(joint).name or f"joint_{joint}"
        yield from _named(name, parts[int(model.jnt_type[joint])])


def _bodies(model: mujoco.MjModel, parts: Parts, mocap: bool) -> Iterator[Column]:
    bodies = list(range(model.nbody))
    if mocap:
        bodies = [body for body in bodies if model.body_mocapid[body] >= 0]
        bodies.sort(key=lambda body: int(model.body_mocapid[body]))
    for body in bodies:
        yield from _named(model.body(body).name or f"body_{body}", parts)


def _activations(model: mujoco.MjModel) -> Iterator[Column]:
    for actuator in range(model.nactuator):
        name = model.actuator(actuator).name or f"actuator_{actuator}"
        count = int(model.actuator_actnum[actuator])
        if count == 1:
            yield Column(name, "")
            continue
        for i in range(count):
            yield Column(f"{name}.{i}", "")


def _controls(model: mujoco.MjModel) -> Iterator[Column]:
    for actuator in range(model.nactuator):
        name = model.actuator(actuator).name
        on_joint = int(model.actuator_trntype[actuator]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        joint = int(model.actuator_trnid[actuator, 0])
        if not name:
            name = model.joint(joint).name if on_joint else f"actuator_{actuator}"
        inputs = int(model.actuator_ctrlnum[actuator])
        if inputs != 1:
            for i in range(inputs):
                yield Column(f"{name}.{mujoco.mj_actuatorInputName(model, actuator, i) or i}", "")
            continue
        # A position servo: force = kp (ctrl - qpos) - ..., so its control is a joint position.
        kp = float(model.actuator_gainprm[actuator, 0])
        has_no_gear = float(model.actuator_gear[model.actuator_outadr[actuator], 0]) == 1
        is_position_servo = kp > 0 and float(model.actuator_biasprm[actuator, 1]) == -kp
        unit = ""
        if on_joint and has_no_gear and is_position_servo:
            unit = _SERVO.get(int(model.jnt_type[joint]), "")
        yield Column(name, unit)


def _named(name: str, parts: Parts) -> Iterator[Column]:
    for part, unit in parts:
        yield Column(f"{name}.{part}" if part else name, unit)
