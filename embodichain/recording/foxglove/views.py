"""The channels for people: poses, joints, looks and numbers of a few environments, and the log.

The thread that steps physics only copies the viewed rows, a few times a simulated second; the
background thread computes their kinematics on models of its own. So looking costs the simulation
next to nothing and cannot disturb it: no derived field of the engine is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import EventRecord, StepRecord
from embodichain.lab.sim.engine.base import F64, EnvIndex, Write
from embodichain.recording.foxglove.frames import Frames
from embodichain.recording.foxglove.log_lines import ending_text, event_text, ids_text, log_line
from embodichain.recording.foxglove.markers import Markers, Taken
from embodichain.recording.foxglove.metrics import Scalars
from embodichain.recording.foxglove.places import pitch_of, places
from embodichain.recording.foxglove.scene import Props
from embodichain.recording.foxglove.viewed import Viewed
from embodichain.recording.mcap_file import Part
from embodichain.recording.options import RecordLike
from embodichain.recording.schemas import scalars_descriptor_set
from embodichain.recording.shapes import LOOKS, PLANE_SIZE

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["SEEN", "Sink", "Views"]

SEEN = (
    *LOOKS,
    *("geom_sameframe", "body_pos", "body_quat", "body_sameframe", "jnt_pos", "jnt_axis", "qpos0"),
)
"""Model fields that move or colour anything begin so."""


class Sink(Protocol):
    """Where messages go, on the background thread: a file, or people who are connected."""

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel; `data` is the schema where it is this run's own."""

    def write(self, topic: str, time_ns: int, parts: Sequence[Part]) -> None:
        """Write or send a message."""


Push = Callable[[Callable[[Sink], None]], None]


class Views:
    """Decides what is sampled when, on the simulation's thread.

    Args:
        env: The environment.
        options: Which environments, and how often.
        push: Called with work for the background thread.
        now: Log time in ns.
    """

    def __init__(
        self, env: BaseEnv, options: RecordLike, push: Push, now: Callable[[], int]
    ) -> None:
        self._ids = np.array(sorted(set(options.view_envs)), np.int64)
        self._is_viewed = np.zeros(env.num_envs, np.bool_)
        self._is_viewed[self._ids] = True
        self._push, self._now = push, now
        self._every = max(1, math.ceil(1.0 / (options.view_hz * float(env.step_dt)) - 1e-9))
        self._reset: set[int] = set()
        self._asked: set[int] = set(self._ids.tolist())
        self._sampled = -1
        self._scalars: Scalars | None = None
        self._rewards = getattr(env, "reward_manager", None)  # environments of others may have none
        model, where = env.sim.engine.model, places(env, self._ids.tolist())
        meshes = Props(pitch_of(env) if len(self._ids) > 1 else PLANE_SIZE)
        self._viewed = [Viewed(model, i, meshes) for i in self._ids.tolist()]
        self._frames = Frames(model, self._ids.tolist(), where.tolist())
        self._markers = Markers(env, self._ids.tolist())
        self.channels = {"/log": "foxglove.Log"}
        if self._viewed:
            self.channels["/tf"] = "foxglove.FrameTransforms"
        for viewed in self._viewed:
            self.channels[viewed.scene_topic] = "foxglove.SceneUpdate"
            self.channels[viewed.joints_topic] = "foxglove.JointStates"
            if self._markers:
                self.channels[viewed.markers_topic] = "foxglove.SceneUpdate"

    def start(self, model_fields: Mapping[str, NDArray[Any]]) -> None:
        """Say that recording begins; take over model fields that are randomized already."""
        self.take_over(model_fields)
        self.say("recording begins")

    def take_over(self, model_fields: Mapping[str, NDArray[Any]]) -> None:
        """Make viewed environments look as these model fields, (N, ...) each, say."""
        for field, values in model_fields.items():
            rows = np.asarray(values[self._ids], np.float64).reshape(len(self._ids), -1)
            self.on_model_write(Write("model", field, self._ids, slice(None), rows))

    def show(self, env_ids: Iterable[int]) -> None:
        """Show the scenes of these environments with the next sample, whatever was shown."""
        self._asked.update(set(env_ids) & set(self._ids.tolist()))

    def say(self, message: str, level: str = "INFO") -> None:
        """Write a line to `/log`."""
        self._push(partial(_write_line, self._now(), message, level))

    def on_model_write(self, write: Write) -> None:
        """A model field of viewed environments changed: their looks and links may have."""
        if write.values is None or not write.field.startswith(SEEN):
            return
        for row, env_id in self._seen(write.env_ids):
            values, viewed = write.values[row].copy(), self._of(env_id)
            self._push(
                lambda _, v=viewed, x=values: v.set_field(write.field, write.columns, x)  # type: ignore[misc]
            )

    def _of(self, env_id: int) -> Viewed:
        return self._viewed[int(np.searchsorted(self._ids, env_id))]

    def _seen(self, env_ids: EnvIndex | None) -> list[tuple[int, int]]:
        """Which of these environments (None: all) are viewed: place among them, and id."""
        if env_ids is None:
            return [(i, i) for i in self._ids.tolist()]
        rows = np.flatnonzero(self._is_viewed[env_ids])
        return list(zip(rows.tolist(), env_ids[rows].tolist(), strict=True))

    def on_rows(self, step: int, rows: F64, last: bool = False) -> None:
        """Physics is about to step: sample the viewed rows when they are due, or after a reset.

        Args:
            step: Control step.
            rows: (N, nstate) live rows.
            last: Nothing follows: sample in any case.
        """
        due = step % self._every == 0 or self._reset or self._asked or last
        if not self._viewed or step == self._sampled or not due:
            return
        self._sampled = step
        scenes = {**dict.fromkeys(self._reset, False), **dict.fromkeys(self._asked, True)}
        self._reset.clear()
        self._asked.clear()
        taken = rows[self._ids], self._markers.take()
        self._push(partial(self._sample, self._now(), *taken, scenes))

    def _sample(
        self, time_ns: int, rows: F64, commands: Taken, scenes: Mapping[int, bool], sink: Sink
    ) -> None:
        """Compute and write what is seen; runs on the background thread."""
        for index, (viewed, row) in enumerate(zip(self._viewed, rows, strict=True)):
            viewed.place(row)
            self._frames.place(index, viewed.data)
            if viewed.env_id in scenes:
                scene = viewed.scene(time_ns, anyway=scenes[viewed.env_id])
                if scene is not None:
                    sink.write(viewed.scene_topic, time_ns, (scene,))
            joints = viewed.joints.encode(time_ns, viewed.data)
            sink.write(viewed.joints_topic, time_ns, (joints,))
            if self._markers:
                drawn = self._markers.encode(time_ns, index, viewed.data, commands)
                sink.write(viewed.markers_topic, time_ns, (drawn,))
        sink.write("/tf", time_ns, (self._frames.encode(time_ns),))

    def on_reset(self, env_ids: EnvIndex) -> None:
        """Viewed environments that were reset show their scene anew."""
        seen = env_ids[self._is_viewed[env_ids]]
        if len(seen):
            self._reset.update(seen.tolist())
            self.say(f"environments {ids_text(seen)} reset")

    def on_event(self, event: EventRecord) -> None:
        """Write a line for each viewed environment in which a term fired, with what it drew."""
        for row, env_id in self._seen(event.env_ids):
            drawn = {name: values[row].copy() for name, values in event.drawn.items()}
            self._push(partial(_write_event, self._now(), env_id, event.term, event.mode, drawn))

    def on_step(self, step: int, record: StepRecord) -> None:
        """Write the numbers of viewed environments when due, and a line for what diverged."""
        diverged = record.info.get("diverged")
        if diverged is not None and record.terminated.any():  # to diverge is to terminate
            ids = np.flatnonzero(np.asarray(diverged))
            if len(ids):
                self.say(f"environments {ids_text(ids)} diverged in step {step}", "WARNING")
        ended = record.terminated[self._ids] | record.truncated[self._ids]
        for env_id in self._ids[ended].tolist():
            self.say(ending_text(record, env_id))
        if not self._viewed or step % self._every:
            return
        manager = self._rewards
        weights = None if manager is None else manager.weights
        taken = self.declare(record).take(record, self._ids, weights)
        self._push(partial(self._number, self._now(), taken))

    def _number(self, time_ns: int, taken: F64, sink: Sink) -> None:
        """Write numbers; runs on the background thread."""
        if self._scalars is not None:
            for viewed, data in zip(self._viewed, self._scalars.encode(taken), strict=True):
                sink.write(viewed.metrics_topic, time_ns, (data,))

    def declare(self, record: StepRecord) -> Scalars:
        """Find the run's scalars in its first step, and declare their channels."""
        if self._scalars is not None:
            return self._scalars
        self._scalars = Scalars(record, self._markers.scalars())
        schema = scalars_descriptor_set("Metrics", self._scalars.names)
        topics = [viewed.metrics_topic for viewed in self._viewed]

        def declare(sink: Sink) -> None:
            for topic in topics:
                sink.channel(topic, "embodichain.Metrics", schema)

        self._push(declare)
        return self._scalars

    def close(self, step: int, rows: F64) -> None:
        """Show the last state, and say that recording ends."""
        self.on_rows(step, rows, last=True)
        self.say(f"recording ends after {step} steps")


def _write_line(time_ns: int, message: str, level: str, sink: Sink) -> None:
    """Write a line; runs on the background thread."""
    sink.write("/log", time_ns, (log_line(time_ns, message, level),))


def _write_event(
    time_ns: int, env_id: int, term: str, mode: str, drawn: Mapping[str, NDArray[Any]], sink: Sink
) -> None:
    """Write a line about an event; runs on the background thread."""
    sink.write("/log", time_ns, (log_line(time_ns, event_text(env_id, term, mode, drawn)),))
