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
from embodichain.recording.foxglove.markers import Colors, Markers
from embodichain.recording.foxglove.metrics import Metrics
from embodichain.recording.foxglove.scene import Props
from embodichain.recording.foxglove.view_spec import Topics, ViewSpec
from embodichain.recording.foxglove.viewed import Viewed
from embodichain.recording.mcap_file import Piece

__all__ = ["PUSHED", "Sink", "ViewEncoder"]

PUSHED = frozenset({"sample", "show", "set_field", "scalars", "numbers", "line", "event"})
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
        self._joints = Joints(model, len(spec.env_ids))
        self._markers = Markers(model, spec.env_ids, spec.markers, datas)
        self._metrics: Metrics | None = None
        self._every, self._sampled = spec.every, -1
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
        return due and step != self._sampled and len(self.env_ids) > 0

    @property
    def scenes_due(self) -> bool:
        """Whether the next sample shows scenes."""
        return bool(self._shown)

    def look_often(
        self, last: int, times: Sequence[int], rows: F64
    ) -> list[tuple[str, list[Piece]]]:
        """Sample control steps that are due without scenes, all with the same commands.

        Args:
            last: The last of the steps.
            times: The moment of each, L of them.
            rows: (L, n, nstate) rows of the viewed environments.

        Returns:
            Topic and pieces of what is to be written at each moment.
        """
        self._sampled = last
        poses: list[F64] = []
        numbers: list[list[float]] = []
        colors: Colors = ()
        for one in rows:
            for viewed, row in zip(self._viewed.values(), one, strict=True):
                viewed.place(row)
            poses.append(self._frames.poses().copy())
            if self._markers:
                colors, drawn = self._markers.drawn(self._commands)
                numbers.append(drawn)
        joints = self._joints.table(times, rows)
        found: list[tuple[str, list[Piece]]] = []
        for index, topics in enumerate(self._topics):
            found.append((topics.joints, [[joints[:, index]]]))
        if self._markers:
            tables = self._markers.table(times, colors, numbers)
            for topics, table in zip(self._topics, tables, strict=True):
                found.append((topics.markers, [[table]]))
        found.append(("/tf", [[self._frames.table(times, np.array(poses))]]))
        return found

    def look(self, step: int, time_ns: int, rows: F64) -> None:
        """Sample a control step that is due.

        Args:
            step: The step.
            time_ns: Its moment.
            rows: (n, nstate) rows of the viewed environments, as physics receives them.
        """
        self._sampled = step
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
        joints = self._joints.encode(time_ns, rows)
        every = zip(self._viewed.values(), self._topics, rows, joints, strict=True)
        for viewed, topics, row, states in every:
            viewed.place(row)
            if viewed.env_id in scenes:
                scene = viewed.scene(time_ns, anyway=scenes[viewed.env_id])
                if scene is not None:
                    found.append((topics.scene, scene))
            found.append((topics.joints, states))
        if self._markers:
            drawn = self._markers.encode(time_ns, commands)
            found += [(t.markers, data) for t, data in zip(self._topics, drawn, strict=True)]
        found.append(("/tf", self._frames.encode(time_ns)))
        self._sink.send(time_ns, found)

    def scalars(self, names: Sequence[str]) -> None:
        """Declare the metrics' channels; these are the fields of `numbers` from here on."""
        metrics = self._metrics = Metrics(names, len(self._topics))
        for topics in self._topics:
            self._sink.channel(topics.metrics, metrics.SCHEMA, metrics.descriptor_set)

    def numbers(self, time_ns: int, taken: F64) -> None:
        """Write the metrics, (S, n).

        Raises:
            RuntimeError: If nobody said which scalars they are.
        """
        every = zip(self._topics, self._declared().encode(taken), strict=True)
        self._sink.send(time_ns, [(topics.metrics, data) for topics, data in every])

    def _declared(self) -> Metrics:
        if self._metrics is None:
            raise RuntimeError("numbers came before the names of the scalars")
        return self._metrics

    def numbers_often(self, taken: F64) -> list[tuple[str, list[Piece]]]:
        """Topic and pieces of the metrics of several moments, (L, S, n)."""
        tables = self._declared().table(taken)
        return [(t.metrics, [[tables[:, i]]]) for i, t in enumerate(self._topics)]

    def line(self, time_ns: int, message: str, level: str) -> None:
        """Write a line to `/log`."""
        self._sink.send(time_ns, [("/log", log_line(time_ns, message, level))])

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
        if mode == "interval":
            if time_ns < self._next_line.get(term, 0):
                return
            self._next_line[term] = time_ns + self._period_ns
        for env_id in self._viewed:
            row = env_id
            if env_ids is not None:
                row = int(np.searchsorted(env_ids, env_id))
                if row == len(env_ids) or env_ids[row] != env_id:
                    continue
            values = {name: array[row] for name, array in zip(names, drawn, strict=True)}
            self.line(time_ns, event_text(env_id, term, mode, values), "INFO")
