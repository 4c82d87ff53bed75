"""`ViewEncoder`: makes the messages for people out of what `Views` pushed.

It runs on another thread or in another process, on models of its own, so looking costs the
simulation next to nothing and cannot disturb it. A process has to start fast: no torch, no
Gymnasium and nothing of a task is imported here, and what is pushed is plain data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.foxglove.frames import Frames
from embodichain.recording.foxglove.joints import Joints
from embodichain.recording.foxglove.log_lines import event_text, log_line
from embodichain.recording.foxglove.markers import Markers
from embodichain.recording.foxglove.metrics import Metrics
from embodichain.recording.foxglove.scene import Props
from embodichain.recording.foxglove.template import stamps
from embodichain.recording.foxglove.view_spec import Topics, ViewSpec
from embodichain.recording.foxglove.viewed import Viewed
from embodichain.recording.mcap_file import Piece

__all__ = ["PUSHED", "Sink", "ViewEncoder"]

PUSHED = frozenset(
    {"sample", "show", "set_field", "scalars", "factors", "numbers", "line", "event"}
)
"""Methods of `ViewEncoder` that may be called by name; whoever receives names refuses others."""


class Sink(Protocol):
    """Where messages go: a file, or people who are connected."""

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel; `data` is the schema where it is this run's own."""

    def send(self, time_ns: int, messages: Sequence[tuple[str, bytes]]) -> None:
        """Write or send messages of one moment, each with its topic."""


class ViewEncoder:
    """Makes and writes messages.

    Args:
        model: The compiled model.
        spec: What is viewed; its channels are declared by whoever owns the sink.
        sink: Where messages go.
    """

    def __init__(self, model: mujoco.MjModel, spec: ViewSpec, sink: Sink) -> None:
        self._sink = sink
        props = Props(spec.ground)
        self._viewed = {i: Viewed(model, i, props) for i in spec.env_ids}
        self._topics = [Topics.of(i) for i in spec.env_ids]
        datas = [viewed.data for viewed in self._viewed.values()]
        self._frames = Frames(model, spec.env_ids, spec.offsets, datas)
        self._joints = Joints(model)
        self._markers = Markers(model, spec.env_ids, spec.markers)
        self._metrics: Metrics | None = None
        self._factors: F64 = np.ones((1, 1))
        self._every = spec.every
        self._shown: dict[int, bool] = {}
        self._commands: tuple[F64, ...] = ()
        self._period_ns = spec.period_ns
        self._next_line: dict[str, int] = {}  # term: when it may have a line again
        self.env_ids: NDArray[np.int64] = np.array(spec.env_ids, np.int64)
        """(n,) environments that are viewed."""

    def set_field(
        self, env_id: int, field: str, columns: NDArray[np.int64] | slice, values: F64
    ) -> None:
        """Give an environment other values, (k,) columns of a flattened model field."""
        self._viewed[env_id].set_field(field, columns, values)

    def show(self, scenes: Mapping[int, bool], *commands: F64) -> None:
        """Sample in this control step with these environments' scenes and commands: see `sample`.

        Without scenes, the step is sampled only if it is due. Commands stay until others come.
        """
        self._shown.update(scenes)
        self._commands = tuple(command.copy() for command in commands)  # their memory is lent

    def is_due(self, step: int) -> bool:
        """Whether a control step is to be sampled, of which nobody pushes the rows."""
        due = self._every > 0 and (step % self._every == 0 or bool(self._shown))
        return due and len(self.env_ids) > 0

    @property
    def scenes_due(self) -> bool:
        """Whether the next sample shows scenes."""
        return bool(self._shown)

    def look_often(self, times: Sequence[int], rows: F64) -> list[tuple[str, list[Piece]]]:
        """Sample control steps that are due without scenes, all with the same commands.

        Args:
            times: The moment of each, L of them.
            rows: (L, n, nstate) rows of the viewed environments.

        Returns:
            Topic and pieces of what is to be written at each moment.
        """
        return [(topic, [[table]]) for topic, table in self._seen(times, rows, self._commands)]

    def _seen(
        self, times: Sequence[int], rows: F64, commands: Sequence[F64]
    ) -> list[tuple[str, NDArray[np.uint8]]]:
        """Topic and (L, bytes) messages of what moves, in (L, n, nstate) rows."""
        poses = np.empty((len(rows), *self._frames.shape))
        for target, one in zip(poses, rows, strict=True):
            for viewed, row in zip(self._viewed.values(), one, strict=True):
                viewed.place(row)
            target[...] = self._frames.poses()
        stamped = stamps(times)
        joints = self._joints.table(stamped, rows)
        found = [(topics.joints, joints[:, i]) for i, topics in enumerate(self._topics)]
        if self._markers:
            markers = self._markers.table(stamped, commands, poses)
            found += [(t.markers, table) for t, table in zip(self._topics, markers, strict=True)]
        found.append(("/tf", self._frames.table(stamped, poses)))
        return found

    def look(self, time_ns: int, rows: F64) -> None:
        """Sample a control step that is due, with the scenes that are.

        Args:
            time_ns: Its moment.
            rows: (n, nstate) rows of the viewed environments, as physics receives them.
        """
        scenes, self._shown = self._shown, {}
        self.sample(time_ns, rows, scenes, *self._commands)

    def sample(self, time_ns: int, rows: F64, scenes: Mapping[int, bool], *commands: F64) -> None:
        """Compute and write what is seen.

        Args:
            time_ns: The moment.
            rows: (n, nstate) rows of the viewed environments.
            scenes: Environments whose scene is due; whether somebody sees it for the first time.
            commands: Values of the drawn commands, (n, K) each.
        """
        found: list[tuple[str, bytes]] = []
        for env_id, anyway in scenes.items():
            scene = self._viewed[env_id].scene(time_ns, anyway)
            if scene is not None:
                found.append((Topics.of(env_id).scene, scene))
        for topic, (message,) in self._seen([time_ns], rows[None], commands):
            found.append((topic, message.tobytes()))
        self._sink.send(time_ns, found)

    def scalars(self, names: Sequence[str]) -> None:
        """Declare the metrics' channels; these are the fields of `numbers` from here on."""
        metrics = self._metrics = Metrics(names)
        for topics in self._topics:
            self._sink.channel(topics.metrics, metrics.SCHEMA, metrics.descriptor_set)

    def factors(self, values: F64) -> None:
        """From here on `numbers` are multiplied with these, (S,)."""
        self._factors = values[:, None].copy()  # its memory is lent

    def numbers(self, time_ns: int, taken: F64) -> None:
        """Write the metrics, (S, n) before they are multiplied.

        Raises:
            RuntimeError: If nobody said which scalars they are.
        """
        (messages,) = self._declared().table(self._factors * taken[None])
        every = zip(self._topics, messages, strict=True)
        self._sink.send(time_ns, [(topics.metrics, data.tobytes()) for topics, data in every])

    def _declared(self) -> Metrics:
        if self._metrics is None:
            raise RuntimeError("numbers came before the names of the scalars")
        return self._metrics

    def numbers_often(self, taken: F64) -> list[tuple[str, list[Piece]]]:
        """Topic and pieces of the metrics of several moments, (L, S, n): see `numbers`."""
        tables = self._declared().table(self._factors * taken)
        return [(t.metrics, [[tables[:, i]]]) for i, t in enumerate(self._topics)]

    def line(self, time_ns: int, message: str, level: str) -> None:
        """Write a line to `/log`."""
        self._sink.send(time_ns, [("/log", log_line(time_ns, message, level))])

    def lines_due(self, time_ns: int, term: str, mode: str) -> bool:
        """Whether a term that fires now has lines: see `event`."""
        return mode != "interval" or time_ns >= self._next_line.get(term, 0)

    def event(
        self,
        time_ns: int,
        term: str,
        mode: str,
        env_ids: NDArray[np.int64] | None,
        names: Sequence[str],
        *drawn: NDArray[Any],
    ) -> None:
        """Write a line for each viewed environment in which a term fired, with what it drew.

        What fires at intervals has lines no more often than anything else is sampled: nobody can
        read a line a step, and `/sim/event` has them all.

        Args:
            time_ns: The moment.
            term: The term.
            mode: Why it fired.
            env_ids: (n,) where it fired, ascending; None is everywhere.
            names: Of what it drew.
            drawn: What it drew, (n, ...) each.
        """
        if not self.lines_due(time_ns, term, mode):
            return
        if mode == "interval":
            self._next_line[term] = time_ns + self._period_ns
        lines: list[tuple[str, bytes]] = []
        for env_id in self._viewed:
            row = env_id
            if env_ids is not None:
                row = int(np.searchsorted(env_ids, env_id))
                if row == len(env_ids) or env_ids[row] != env_id:
                    continue
            values = {name: array[row] for name, array in zip(names, drawn, strict=True)}
            text = event_text(env_id, term, mode, values)
            lines.append(("/log", log_line(time_ns, text, "INFO")))
        if lines:
            self._sink.send(time_ns, lines)
