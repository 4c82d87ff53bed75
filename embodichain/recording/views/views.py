"""`Views`: samples viewed environments and writes the messages for viewers.

It reads the engine's rows and model fields and computes kinematics on a separate model, so viewing
changes nothing in the simulation.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np

from embodichain.lab.sim.engine.api import F64, Engine, Write
from embodichain.lab.sim.engine.fields import row_layout
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.views.channels import (
    METRICS,
    Frames,
    Joints,
    Scalars,
    ending_text,
    event_text,
    ids_text,
    log_line,
)
from embodichain.recording.views.layout import pitch_of, places
from embodichain.recording.views.scene import Commands, Scenes
from embodichain.recording.views.shapes import LOOKS, PLANE_SIZE
from embodichain.utils.array_types import EnvIds, host_ids

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import EventRecord, ObservedEnv, StepRecord

__all__ = ["Sink", "Views"]

_VISIBLE_FIELDS = (
    *LOOKS,
    "geom_sameframe",
    "body_pos",
    "body_quat",
    "body_sameframe",
    "jnt_pos",
    "jnt_axis",
    "qpos0",
)
"""Prefixes of the model fields that affect poses or colours."""
_LINE_INTERVAL_NS = 1_000_000_000
"""Smallest interval between two lines of an interval term, in ns of simulated time."""


class Sink(Protocol):
    """The receiver of messages: a file, or connected viewers."""

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel; `data` is the schema's FileDescriptorSet if `schema` has none."""

    def send(self, time_ns: int, messages: Iterable[tuple[str, bytes]]) -> None:
        """Write or send serialized messages of one time, each with its topic.

        Messages are encoded during iteration: a file encodes many samples at a time, which is
        several times faster than encoding between steps.
        """


class Views:
    """Writes the channels of viewed environments, and `/log`.

    Args:
        env: The environment.
        options: Viewed environments, and their sampling rate.
        sink: Receives the messages; channels are declared at once, those of metrics in the first
            step.
        now: Returns the log time in ns.
    """

    def __init__(
        self, env: ObservedEnv, options: RecordOptions, sink: Sink, now: Callable[[], int]
    ) -> None:
        self._ids = np.array(sorted(set(options.view_envs)), np.int64)
        self._is_viewed = np.zeros(env.num_envs, np.bool_)
        self._is_viewed[self._ids] = True
        self._sink = sink
        self._now = now
        self._every = max(1, math.ceil(1.0 / (options.view_hz * float(env.step_dt)) - 1e-9))
        self._due: dict[int, bool] = dict.fromkeys(self._ids.tolist(), True)
        """Environments with a scene to write; True: even if it is unchanged."""
        self._last_sample = -1  # control step
        self._next_line: dict[str, int] = {}  # interval term to time of its next line
        self._rewards = getattr(env, "reward_manager", None)  # other classes may have no manager
        self._commands = Commands(env)
        self._scalars: Scalars | None = None
        engine = env.sim.engine
        scenes = Scenes(pitch_of(env) if len(self._ids) > 1 else PLANE_SIZE)
        changed = {name for name in engine.model_fields() if name.startswith(_VISIBLE_FIELDS)}
        self._viewed = {i: _ViewedEnv(engine, i, scenes, changed) for i in self._ids.tolist()}
        self._models: list[mujoco.MjModel] = []  # of the viewed environments
        self._models_changed = True  # since they were read
        self._models_may_change = False
        self._data = mujoco.MjData(engine.model)
        self._frames = Frames(engine.model, list(self._viewed), places(env, self._ids.tolist()))
        self._joints = Joints(engine.model)
        layout = row_layout(engine.model)
        # Arrays of `self._data` that kinematics reads, and their columns in a row.
        self._inputs: list[tuple[F64, slice]] = []
        for name in ("qpos", "mocap_pos", "mocap_quat"):
            values = getattr(self._data, name)
            if values.size:
                self._inputs.append((values.reshape(-1), layout[name]))
        sink.channel("/log", "foxglove.Log")
        if self._viewed:
            sink.channel("/tf", "foxglove.FrameTransforms")
        for viewed in self._viewed.values():
            sink.channel(viewed.scene, "foxglove.SceneUpdate")
            sink.channel(viewed.joints, "foxglove.JointStates")
            if self._commands.drawn:
                sink.channel(viewed.markers, "foxglove.SceneUpdate")

    def say(self, message: str, level: str = "INFO") -> None:
        """Write a line to `/log`."""
        self._send_lines([message], level)

    def _send_lines(self, texts: list[str], level: str = "INFO") -> None:
        time_ns = self._now()
        self._sink.send(time_ns, (("/log", log_line(time_ns, text, level)) for text in texts))

    def show(self, env_ids: Iterable[int]) -> None:
        """Write the scenes of these environments with the next sample, even if unchanged."""
        self._due.update(dict.fromkeys(self._viewed.keys() & set(env_ids), True))

    def on_model_write(self, write: Write) -> None:
        """Note that a model field of viewed environments has changed."""
        if write.field.startswith(_VISIBLE_FIELDS):
            ids = None if write.env_ids is None else host_ids(write.env_ids)
            for env_id in self._viewed_of(ids):
                self._viewed[env_id].changed.add(write.field)
                self._models_changed = True

    def _viewed_of(self, env_ids: EnvIds | None) -> list[int]:
        """Which of these environments (None: all) are viewed."""
        if env_ids is None:
            return list(self._viewed)
        viewed_ids: list[int] = env_ids[self._is_viewed[env_ids]].tolist()
        return viewed_ids

    def on_rows(self, step: int, rows: F64, last: bool = False) -> None:
        """Sample the viewed rows if they are due, or after a reset.

        Args:
            step: The control step before its physics.
            rows: (N, nstate) rows.
            last: Whether this is the last state, which is always sampled.
        """
        if not self._viewed or step == self._last_sample:
            return
        if step % self._every and not self._due and not last:
            return
        self._last_sample = step
        time_ns = self._now()
        scenes = self._encode_scenes(time_ns) if self._due else []
        if self._models_changed:
            self._read_models()
        commands = self._commands.values_of(self._ids)
        messages = self._encoded(time_ns, scenes, rows[self._ids], self._models, commands)
        if self._models_may_change:
            # Encode now: the models may be other ones when the file is written.
            messages = iter(list(messages))
        self._sink.send(time_ns, messages)

    def _read_models(self) -> None:
        """Read the models of the viewed environments, after a change of some of them."""
        self._models_changed = False
        self._models = [viewed.model for viewed in self._viewed.values()]
        self._models_may_change = any(viewed.owns_model for viewed in self._viewed.values())

    def _encode_scenes(self, time_ns: int) -> list[tuple[str, bytes]]:
        """Encode the scenes that are due."""
        scenes = []
        for env_id, even_if_unchanged in self._due.items():
            viewed = self._viewed[env_id]
            scene = viewed.encode_scene(time_ns, even_if_unchanged)
            if scene is not None:
                scenes.append((viewed.scene, scene))
        self._due = {}
        return scenes

    def _encoded(
        self,
        time_ns: int,
        scenes: list[tuple[str, bytes]],
        rows: F64,
        models: list[mujoco.MjModel],
        commands: list[F64],
    ) -> Iterator[tuple[str, bytes]]:
        """Encode a sample of the n viewed environments.

        Args:
            time_ns: Time of the sample.
            scenes: The messages of scenes.
            rows: (n, nstate) states.
            models: The n models.
            commands: (n, columns) values of each command that is drawn.
        """
        yield from scenes
        data = self._data
        for index, (env_id, viewed) in enumerate(self._viewed.items()):
            row = rows[index]
            for target, columns in self._inputs:
                target[:] = row[columns]
            mujoco.mj_kinematics(models[index], data)
            self._frames.place(index, data)
            yield viewed.joints, self._joints.encode(time_ns, row)
            if commands:
                env_commands = [values[index] for values in commands]
                yield viewed.markers, self._commands.encode(time_ns, env_id, data, env_commands)
        yield "/tf", self._frames.encode(time_ns)

    def on_reset(self, env_ids: EnvIds) -> None:
        """Sample viewed environments that were reset, and their scene if it changed."""
        viewed_ids = self._viewed_of(env_ids)
        if viewed_ids:
            for env_id in viewed_ids:
                self._due.setdefault(env_id, False)
            self.say(f"environments {ids_text(np.array(viewed_ids))} reset")

    def on_event(self, event: EventRecord) -> None:
        """Write a line with the drawn values for each viewed environment in which a term fired.

        An interval term has at most one line a simulated second; the log's events are complete.
        """
        ids = event.env_ids
        if event.mode == "interval":
            time_ns = self._now()
            if time_ns < self._next_line.get(event.term, 0):
                return
            self._next_line[event.term] = time_ns + _LINE_INTERVAL_NS
        texts = []
        for env_id in self._viewed_of(ids):
            row = env_id if ids is None else int(np.searchsorted(ids, env_id))
            drawn = {name: values[row] for name, values in event.drawn.items()}
            texts.append(event_text(env_id, event.term, event.mode, drawn))
        if texts:
            self._send_lines(texts)

    def on_step(self, step: int, record: StepRecord, ended: bool = True) -> None:
        """Write the scalars of viewed environments if they are due, and a line for each end.

        Args:
            step: Control step.
            record: The results of the step.
            ended: Whether an episode may have ended in any environment.
        """
        if ended:
            self._say_endings(step, record)
        if self._viewed and step % self._every == 0:
            scalars = self.declare(record)
            samples = scalars.sample(record, self._viewed)
            weights = {} if self._rewards is None else self._rewards.weights
            messages = (
                (viewed.metrics, scalars.encode(sample, weights))
                for viewed, sample in zip(self._viewed.values(), samples, strict=True)
            )
            self._sink.send(self._now(), messages)

    def _say_endings(self, step: int, record: StepRecord) -> None:
        diverged = record.info.get("diverged")
        if diverged is not None and record.terminated.any():  # divergence terminates
            ids = np.flatnonzero(np.asarray(diverged))
            if len(ids):
                self.say(f"environments {ids_text(ids)} diverged in step {step}", "WARNING")
        has_ended = record.terminated[self._ids] | record.truncated[self._ids]
        for env_id in self._ids[has_ended].tolist():
            self.say(ending_text(record, env_id))

    def declare(self, record: StepRecord) -> Scalars:
        """Return the run's scalars; the first call declares their channels."""
        if self._scalars is None:
            self._scalars = Scalars(record, self._commands.scalars())
            schema = self._scalars.descriptor_set
            for viewed in self._viewed.values():
                self._sink.channel(viewed.metrics, f"embodichain.{METRICS}", schema)
        return self._scalars

    def close(self, step: int, rows: F64) -> None:
        """Write the last state, and a line that recording ends."""
        self.on_rows(step, rows, last=True)
        self.say(f"recording ends after {step} steps")


class _ViewedEnv:
    """The topics and the model of one environment.

    Args:
        engine: The engine.
        env_id: The environment.
        scenes: Encoder of scenes.
        changed: Model fields that already differ between environments.

    Attributes:
        changed: Model fields that have changed since they were read.
        owns_model: Whether the environment's model is a separate copy.
        scene, joints, markers, metrics: Its topics.
    """

    def __init__(self, engine: Engine, env_id: int, scenes: Scenes, changed: set[str]) -> None:
        self._engine = engine
        self._env_id = env_id
        self._scenes = scenes
        self._model = engine.model
        self.owns_model = False
        self._scene_changed = True
        self.changed = set(changed)
        self.scene = f"/env_{env_id}/scene"
        self.joints = f"/env_{env_id}/joint_states"
        self.markers = f"/env_{env_id}/markers"
        self.metrics = f"/env_{env_id}/metrics"

    @property
    def model(self) -> mujoco.MjModel:
        """The environment's model with the current values of the fields in `_VISIBLE_FIELDS`."""
        if self.changed:
            if not self.owns_model:
                self._model = copy.copy(self._model)
                self.owns_model = True
            for field in self.changed:
                values = self._engine.model_field(field)[self._env_id]
                getattr(self._model, field).reshape(-1)[:] = values
            self._scene_changed |= any(field.startswith(LOOKS) for field in self.changed)
            self.changed = set()
        return self._model

    def encode_scene(self, time_ns: int, even_if_unchanged: bool) -> bytes | None:
        """Return the `SceneUpdate`; None if the scene is unchanged and need not be written."""
        model = self.model
        if not self._scene_changed and not even_if_unchanged:
            return None
        self._scene_changed = False
        return self._scenes.encode(time_ns, model, self._env_id)
