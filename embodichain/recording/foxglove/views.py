"""The channels for people: poses, joints, looks and numbers of a few environments, and the log.

The thread that steps physics only copies the viewed rows, a few times a simulated second; the
background thread computes their kinematics on models of its own. So looking costs the simulation
next to nothing and cannot disturb it: no derived field of the engine is asked for.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import StepRecord
from embodichain.lab.sim.engine.base import F64, EnvIndex, Write
from embodichain.lab.sim.engine.layout import row_layout
from embodichain.recording.foxglove.frames import Frames
from embodichain.recording.foxglove.joints import Joints
from embodichain.recording.foxglove.messages import Log, timestamp
from embodichain.recording.foxglove.metrics import Scalars
from embodichain.recording.foxglove.scene import Scene
from embodichain.recording.mcap_file import Part
from embodichain.recording.options import RecordLike
from embodichain.recording.schemas import scalars_descriptor_set
from embodichain.recording.writer import Job, McapThread

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["Views", "ids_text"]

BIG_SCENE = 1 << 20
"""A scene of more bytes than this is repeated at a reset only if it has changed."""
SEEN = (
    *("geom_size", "geom_pos", "geom_quat", "geom_sameframe", "geom_rgba", "geom_matid", "mat_"),
    *("body_pos", "body_quat", "body_sameframe", "jnt_pos", "jnt_axis", "qpos0"),
)
"""Model fields that move or colour anything begin so."""

Emit = Callable[[str, tuple[Part, ...]], None]
Push = Callable[[Job], None]


class Views:
    """Decides what is sampled when, on the simulation's thread.

    Args:
        env: The environment.
        options: Which environments, and how often.
        emit: Called with a topic and the parts of a message.
        push: Called with work for the background thread.
        now: Log time in ns.
    """

    def __init__(
        self, env: BaseEnv, options: RecordLike, emit: Emit, push: Push, now: Callable[[], int]
    ) -> None:
        self._ids = np.array(sorted(set(options.view_envs)), np.int64)
        self._emit, self._push, self._now = emit, push, now
        self._every = max(1, math.ceil(1.0 / (options.view_hz * float(env.step_dt)) - 1e-9))
        self._reset: set[int] = set(self._ids.tolist())
        self._sampled = -1
        self._scalars: Scalars | None = None
        model, offsets = env.sim.engine.model, env.sim.arena_offsets
        self._viewed = [_Viewed(model, i) for i in self._ids.tolist()]
        self._frames = Frames(model, self._ids.tolist(), offsets[self._ids].tolist())
        self.channels = {"/log": "foxglove.Log"}
        if self._viewed:
            self.channels["/tf"] = "foxglove.FrameTransforms"
        for viewed in self._viewed:
            self.channels[viewed.scene_topic] = "foxglove.SceneUpdate"
            self.channels[viewed.joints_topic] = "foxglove.JointStates"

    def start(self, model_fields: dict[str, NDArray[Any]]) -> None:
        """Say that recording begins; take over model fields that are randomized already."""
        for field, values in model_fields.items():
            whole = np.asarray(values, np.float64).reshape(len(values), -1)
            self.on_model_write(Write("model", field, None, slice(None), whole))
        self.say("recording begins")

    def say(self, message: str, level: str = "INFO") -> None:
        """Write a line to `/log`."""
        stamp = timestamp(self._now())
        line = Log(timestamp=stamp, level=Log.Level.Value(level), message=message)
        line.name = "embodichain"
        self._emit("/log", (line.SerializeToString(),))

    def on_model_write(self, write: Write) -> None:
        """A model field of viewed environments changed: their looks and links may have."""
        if write.values is None or not write.field.startswith(SEEN):
            return
        ids = self._ids if write.env_ids is None else np.intersect1d(self._ids, write.env_ids)
        for env_id in ids.tolist():
            row = env_id if write.env_ids is None else int(np.searchsorted(write.env_ids, env_id))
            values, viewed = write.values[row].copy(), self._of(env_id)
            self._push(
                lambda _, v=viewed, x=values: v.set_field(write.field, write.columns, x)  # type: ignore[misc]
            )

    def _of(self, env_id: int) -> _Viewed:
        return self._viewed[int(np.searchsorted(self._ids, env_id))]

    def on_rows(self, step: int, rows: F64, last: bool = False) -> None:
        """Physics is about to step: sample the viewed rows when they are due, or after a reset.

        Args:
            step: Control step.
            rows: (N, nstate) live rows.
            last: Nothing follows: sample in any case.
        """
        due = step % self._every == 0 or self._reset or last
        if not self._viewed or step == self._sampled or not due:
            return
        self._sampled = step
        taken, time_ns, reset = rows[self._ids], self._now(), frozenset(self._reset)
        self._reset.clear()
        self._push(lambda file: self._sample(file, time_ns, taken, reset))

    def _sample(self, file: McapThread, time_ns: int, rows: F64, reset: frozenset[int]) -> None:
        """Compute and write what is seen; runs on the background thread."""
        for index, (viewed, row) in enumerate(zip(self._viewed, rows, strict=True)):
            viewed.place(row)
            self._frames.place(index, viewed.data)
            if viewed.env_id in reset:
                scene = viewed.scene(time_ns)
                if scene is not None:
                    file.write(viewed.scene_topic, time_ns, (scene,))
            joints = viewed.joints.encode(time_ns, viewed.data)
            file.write(viewed.joints_topic, time_ns, (joints,))
        file.write("/tf", time_ns, (self._frames.encode(time_ns),))

    def on_reset(self, env_ids: EnvIndex) -> None:
        """Viewed environments that were reset show their scene anew."""
        seen = np.intersect1d(self._ids, env_ids)
        if len(seen):
            self._reset.update(seen.tolist())
            self.say(f"environments {ids_text(seen)} reset")

    def on_step(self, step: int, record: StepRecord) -> None:
        """Write the numbers of viewed environments when due, and a line for what diverged."""
        diverged = record.info.get("diverged")
        if diverged is not None and record.terminated.any():  # to diverge is to terminate
            ids = np.flatnonzero(np.asarray(diverged))
            if len(ids):
                self.say(f"environments {ids_text(ids)} diverged in step {step}", "WARNING")
        if not self._viewed or step % self._every:
            return
        if self._scalars is None:
            self._scalars = Scalars(record)
            schema = scalars_descriptor_set("Metrics", self._scalars.names)
            topics = [viewed.metrics_topic for viewed in self._viewed]

            def declare(file: McapThread) -> None:
                for topic in topics:
                    file.channel(topic, "embodichain.Metrics", schema)

            self._push(declare)
        for viewed in self._viewed:
            data = self._scalars.encode(record, viewed.env_id)
            self._emit(viewed.metrics_topic, (data,))

    def close(self, step: int, rows: F64) -> None:
        """Show the last state, and say that recording ends."""
        self.on_rows(step, rows, last=True)
        self.say(f"recording ends after {step} steps")


class _Viewed:
    """One environment as the background thread sees it."""

    def __init__(self, model: mujoco.MjModel, env_id: int) -> None:
        self.env_id = env_id
        self._model = model
        self._owned = False
        self.data = mujoco.MjData(model)
        self.joints = Joints(model)
        layout, data = row_layout(model), self.data
        fields = ("qpos", "qvel", "mocap_pos", "mocap_quat")
        self._inputs = [(getattr(data, name), layout[name]) for name in fields]
        self._scene: Scene | None = None
        self._big = False
        root = f"/env_{env_id}"
        self.scene_topic, self.joints_topic = f"{root}/scene", f"{root}/joint_states"
        self.metrics_topic = f"{root}/metrics"

    def set_field(self, field: str, columns: NDArray[np.int64] | slice, values: F64) -> None:
        """Give this environment's own model other values, (k,) columns of a flattened field."""
        if not self._owned:
            self._model, self._owned = copy.copy(self._model), True
        getattr(self._model, field).reshape(-1)[columns] = values
        self._scene = None

    def place(self, row: F64) -> None:
        """Compute where every body is."""
        for target, columns in self._inputs:
            target[...] = row[columns].reshape(target.shape)
        mujoco.mj_kinematics(self._model, self.data)

    def scene(self, time_ns: int) -> bytes | None:
        """What it looks like now; None if it is big and was written already."""
        changed = self._scene is None
        if self._scene is None:
            self._scene = Scene(self._model, self.env_id)
        if self._big and not changed:
            return None
        data = self._scene.update(time_ns)
        self._big = len(data) > BIG_SCENE
        return data


def ids_text(ids: NDArray[np.int64], most: int = 8) -> str:
    """``0, 3, 5 (and 12 more)``."""
    shown = ", ".join(str(i) for i in ids[:most])
    return shown if len(ids) <= most else f"{shown} (and {len(ids) - most} more)"
