"""Kinematics of recorded states, with the model as the environment had it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part
from embodichain.recording.playback import Playback, span_of

__all__ = ["Posed", "poses"]


class Posed(NamedTuple):
    """One environment in one control step; arrays and data change with the next one.

    Attributes:
        step: The control step.
        data: The state that physics received, with kinematics; `data.model` has the environment's
            own fields.
        changed: Whether that model is another than in the step before.
    """

    step: int
    data: mujoco.MjData
    changed: bool


def poses(log: Log, env: int, part: Part) -> Iterator[Posed]:
    """Yield the control steps of a part of one environment.

    Raises:
        ConfigError: If the part does not exist.
        LogError: If the log is damaged.
    """
    last = None if part.stop is None else part.stop - 1
    playback, changes = Playback(log, env), -1
    data = mujoco.MjData(log.model)
    for step in playback.steps(span_of(log, env, part.episode, part.start, last)):
        changed = playback.changes != changes
        if changed:
            changes, data = playback.changes, mujoco.MjData(playback.engine.model_of(0))
        state = playback.engine.rows[0]
        mujoco.mj_setState(data.model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_kinematics(data.model, data)
        yield Posed(step, data, changed)
