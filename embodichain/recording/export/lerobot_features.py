"""What a frame of a LeRobot data set holds, and where in a log it stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.views.motion import scalar_joints

__all__ = ["INDICES", "Columns", "Feature", "features_of"]

INDICES: Mapping[str, str] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Columns that every data set has, with their types."""

Columns = Mapping[str, NDArray[Any]]
"""Field of a log, `done` or `success` to (T, K) values of one episode."""


@dataclass(frozen=True, slots=True)
class Feature:
    """Columns that make up one feature.

    Attributes:
        key: Its name.
        dtype: float32 or bool.
        sources: Fields and their columns.
        names: Of its numbers.
    """

    key: str
    dtype: str
    sources: Mapping[str, NDArray[np.int64]]
    names: tuple[str, ...]

    def of(self, columns: Columns) -> NDArray[Any]:
        """(T, K) values."""
        parts = [columns[field][:, ids] for field, ids in self.sources.items()]
        whole: NDArray[Any] = np.concatenate(parts, axis=1).astype(self.dtype)
        return whole

    def info(self) -> dict[str, Any]:
        """As `info.json` has it."""
        return {"dtype": self.dtype, "shape": [len(self.names)], "names": list(self.names)}


def features_of(log: Log) -> list[Feature]:
    """Features of a log: joints are the robot's state, what floats is the environment's.

    A state is as physics received it; rewards and ends are of what followed, hence ``next``.
    """
    positions, floating = _columns(log.model, "qpos")
    velocities, _ = _columns(log.model, "qvel")
    rest = {"qpos": floating} | {field: _all(log, field) for field in ("mocap_pos", "mocap_quat")}
    made = [
        _feature(log, "observation.state", {"qpos": positions}),
        _feature(log, "observation.velocity", {"qvel": velocities}),
        _feature(log, "observation.environment_state", rest),
        _feature(log, "action", {"actions": _all(log, "actions")}),
        _single("next.reward", "float32", "rewards"),
        _single("next.done", "bool", "done"),
        _single("next.success", "bool", "success"),
    ]
    return [feature for feature in made if feature.names]


def _feature(log: Log, key: str, columns: Mapping[str, list[int]]) -> Feature:
    there = {field: np.array(ids, np.int64) for field, ids in columns.items() if ids}
    names = [log.columns[field][i].name for field, ids in there.items() for i in ids.tolist()]
    return Feature(key, "float32", there, tuple(names))


def _single(key: str, dtype: str, field: str) -> Feature:
    return Feature(key, dtype, {field: np.zeros(1, np.int64)}, (field,))


def _columns(model: mujoco.MjModel, field: str) -> tuple[list[int], list[int]]:
    """Columns of joints with one coordinate, and those of the others."""
    starts, total = (
        (model.jnt_qposadr, model.nq) if field == "qpos" else (model.jnt_dofadr, model.nv)
    )
    bounds = [*(int(at) for at in starts), int(total)]
    found: tuple[list[int], list[int]] = ([], [])
    scalar = set(scalar_joints(model).values())
    for joint in range(model.njnt):
        found[joint not in scalar].extend(range(bounds[joint], bounds[joint + 1]))
    return found


def _all(log: Log, field: str) -> list[int]:
    return list(range(len(log.columns.get(field, ()))))
