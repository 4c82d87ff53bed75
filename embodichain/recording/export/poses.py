"""Where bodies were: kinematics of recorded states, on a model as each environment had it."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.arrays import LogArrays
from embodichain.recording.messages import WriteRecord

__all__ = ["INPUTS", "MOVES", "ModelHistory", "Poses"]

INPUTS = ("qpos", "mocap_pos", "mocap_quat")
"""Components that kinematics needs."""
MOVES = ("body_pos", "body_quat", "jnt_pos", "jnt_axis", "qpos0")
"""Model fields that kinematics reads."""


class ModelHistory:
    """The model of one environment as it was before the physics of a step.

    Args:
        log: The log.
        env_id: The environment.
        fields: Model fields that are followed: whole names, or how they begin.

    Attributes:
        model: A copy, as far as `until` has been told.
    """

    def __init__(self, log: Log, env_id: int, fields: tuple[str, ...]) -> None:
        self.model = copy.copy(log.model)
        self._env = env_id
        written = (w for w in log.writes() if w.op == "model" and w.field.startswith(fields))
        self._writes = [w for w in written if _reaches(w, env_id)]
        self._done = 0

    def until(self, step: int) -> bool:
        """Apply what was written before the physics of a step; whether anything was.

        An automatic reset writes after the physics of its step, for the next one.
        """
        first = self._done
        while self._done < len(self._writes):
            write = self._writes[self._done]
            if write.step + (write.phase == "after_physics") > step:
                break
            self._apply(write)
            self._done += 1
        return self._done > first

    def _apply(self, write: WriteRecord) -> None:
        if write.env_ids is None:
            rows, row = len(write.values), self._env
        else:
            rows, row = len(write.env_ids), int(np.flatnonzero(write.env_ids == self._env)[0])
        target = getattr(self.model, write.field).reshape(-1)
        width = len(target[write.columns])
        if rows * width != len(
            write.values
        ):  # all environments: their number is not in the message
            rows = len(write.values) // width
        target[write.columns] = write.values.reshape(rows, width)[row]


def _reaches(write: WriteRecord, env_id: int) -> bool:
    return write.env_ids is None or bool((write.env_ids == env_id).any())


class Poses:
    """Poses of all bodies of one environment.

    Args:
        log: The log.
        env_id: The environment.
    """

    def __init__(self, log: Log, env_id: int) -> None:
        self._history = ModelHistory(log, env_id, MOVES)
        self._data = mujoco.MjData(self._history.model)

    def of(self, data: LogArrays, column: int) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Yield step and (nbody - 1, 7) positions and quaternions, in the environment's world.

        Args:
            data: `INPUTS`, as far as the model has them; later steps than before.
            column: Where the environment stands in them.
        """
        model = self._history.model
        inputs = [name for name in INPUTS if name in data.values]
        poses = np.empty((model.nbody - 1, 7))
        for index, step in enumerate(data.steps.tolist()):
            self._history.until(step)
            for name in inputs:
                values = getattr(self._data, name)
                values[:] = data[name][index, column].reshape(values.shape)
            mujoco.mj_kinematics(model, self._data)
            poses[:, :3], poses[:, 3:] = self._data.xpos[1:], self._data.xquat[1:]
            yield step, poses
