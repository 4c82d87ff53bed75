"""`LogBuilder`: carries out the recorder's calls, by name, in the process that writes the log.

It brings together what replay needs (`state_log`), how episodes end (`episode_log`), what people
look at (`view_encoder`) and the file (`log_file`).
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64, EnvIndex
from embodichain.recording import state_log
from embodichain.recording.attachments import load_mjb
from embodichain.recording.batches import AlikeSteps, Batches
from embodichain.recording.episode_log import TOPIC as EPISODE_TOPIC
from embodichain.recording.episode_log import Ends, EpisodeLog
from embodichain.recording.foxglove.view_encoder import ViewEncoder
from embodichain.recording.header import METADATA, METADATA_END
from embodichain.recording.log_file import LogFile
from embodichain.recording.log_head import LogHead
from embodichain.recording.mcap_file import Part
from embodichain.recording.parts import Manifest, part_name
from embodichain.recording.seen_together import VIEW, SeenTogether
from embodichain.recording.steady_log import SteadyLog

__all__ = ["LAYOUT_FILE", "LogBuilder"]

LAYOUT_FILE = "foxglove_layout.json"


class LogBuilder:
    """A log in progress; building it writes the head.

    Args:
        file: Where it is written.
        head: What it begins with.
        give_way: Called often, by a process that others go before.

    Attributes:
        batches: Takes the recorder's calls.
    """

    def __init__(self, file: LogFile, head: LogHead, give_way: Callable[[], None]) -> None:
        self.file = file
        header = self._header = head.header
        self._attachments = head.attachments
        model = load_mjb(next(data for name, _, data in head.attachments if name == "model.mjb"))
        self._start_ns, self._period_ns = header.start_ns, header.period_ns
        layout = {name: slice(*columns) for name, columns in header.layout.items()}
        derives = header.state == "all"
        self._log = SteadyLog(model, layout, header.substeps, derives, self._write)
        self._episodes = EpisodeLog(header.num_envs)
        self._views = ViewEncoder(model, head.views, file)
        self._seen = SeenTogether(self._views, file)
        self._manifest = Manifest(file.folder, file.name, header.log_id, header.period_ns * 1e-9)
        self._write_head(0, 0)
        if not head.rolls:
            self._attachments = []  # not needed again
        channels = dict(state_log.CHANNELS) if header.state != "none" else {}
        channels |= {EPISODE_TOPIC: "embodichain.Episodes"} | head.views.channels
        for topic, schema in channels.items():
            file.channel(topic, schema)
        _write_layout(file.folder, head.layout)
        log = self._log
        methods: dict[str, Callable[..., None]] = {
            "start": log.start,
            "began": file.began,
            "columns": log.columns,
            "place": log.place,
            "write": log.on_write,
            "before": self._before,
            "after": log.after_physics,
            "stepped": self._stepped,
            "event": self._event,
            "step": self._step,
            "unseen_step": self._unseen_step,
            "skip": log.skip,
            "end": log.close,
            "roll": self._roll,
            "finish": self._finish,
            **self._seen.methods(),
        }
        self.batches = Batches(methods, "step", VIEW, self._together, give_way)

    def flush(self) -> None:
        """Make everything readable in the file.

        Raises:
            OSError: If it cannot be written, or was removed.
        """
        self._seen.finish()
        self.file.flush()

    def settle(self) -> None:
        """A batch is carried out: let go of arrays that were handed over, and count."""
        self._log.settle()
        self.file.count()

    def _write_head(self, part: int, first_step: int) -> None:
        for name, media_type, data in self._attachments:
            self.file.attach(name, media_type, data, self._start_ns)
        header = replace(self._header, part=part, first_step=first_step)
        self.file.metadata(METADATA, header.to_metadata())

    def _write(self, step: int, topic: str, parts: tuple[Part, ...]) -> None:
        self.file.write(topic, self._time_of(step), parts)

    def _time_of(self, step: int) -> int:
        """Log time of a control step, ns."""
        return self._start_ns + step * self._period_ns

    def _before(self, nstep: int, ids: EnvIndex | None, taken: F64 | None) -> None:
        """Physics is called with these rows."""
        self._log.before_physics(nstep, ids, taken)
        self._look(ids)

    def _stepped(
        self, nstep: int, ids: EnvIndex | None, failed: EnvIndex | None, taken: F64
    ) -> None:
        """Physics was called with the rows that are known, and returned these."""
        self._look(ids)
        self._log.stepped(nstep, ids, failed, taken)

    def _look(self, ids: EnvIndex | None) -> None:
        step, seen = self._log.step, self._seen
        if ids is None and seen.is_due(step):
            seen.look(step, self._time_of(step), self._log.rows_of(self._views.env_ids))

    def _together(self, steps: AlikeSteps) -> int | None:
        """Control steps that are alike; how many of them the log takes together."""
        log, views, seen = self._log, self._views, self._seen
        kind = log.kind_of(steps.calls)
        if kind is None:
            return None
        found = log.together(steps, kind)
        if found is None:
            return 0
        times = [self._time_of(log.step + k) for k in range(found.count)]
        self.file.write_rows(found.messages, times)
        events = [
            (call.args, arrays)
            for call, arrays in zip(kind.calls, found.arrays, strict=True)
            if call.name == "event"
        ]
        _, rewards, episode_ids = found.arrays[-1]
        asides = deque(steps.asides)
        seen.begin(found, log.step, times)
        for k, time_ns in enumerate(times):
            while asides and asides[0].step == k and asides[0].after <= kind.physics:
                asides.popleft().carry_out()
            seen.step(k)
            for args, drawn in events:
                if views.lines_due(time_ns, *args[:2]):
                    views.event(time_ns, *args, *[values[k] for values in drawn])
            while asides and asides[0].step == k:
                asides.popleft().carry_out()
        self._episodes.add_steps(rewards, episode_ids)
        seen.end()
        found.finish()
        return found.count

    def _step(
        self,
        ends: Ends | None,
        action: F64,
        reward: NDArray[Any],
        episode_ids: NDArray[np.int64],
        terminated: NDArray[np.bool_] | None = None,
        truncated: NDArray[np.bool_] | None = None,
    ) -> None:
        """A control step ended; nobody is terminated or truncated if it does not say who."""
        step = self._log.step
        if self._header.state != "none":
            if terminated is None or truncated is None:
                terminated = truncated = np.zeros(len(reward), np.bool_)
            self._log.on_step(action, reward, terminated, truncated, episode_ids)
        else:
            self._log.skip()
        self._take_in(step, ends, reward, episode_ids)

    def _event(
        self,
        term: str,
        mode: str,
        env_ids: EnvIndex | None,
        names: tuple[str, ...],
        *drawn: NDArray[Any],
    ) -> None:
        """A term of the event manager fired, and drew these values."""
        log = self._log
        if self._header.state != "none":
            log.on_event(term, mode, env_ids, dict(zip(names, drawn, strict=True)))
        self._views.event(self._time_of(log.step), term, mode, env_ids, names, *drawn)

    def _unseen_step(
        self, ends: Ends | None, reward: NDArray[Any], episode_ids: NDArray[np.int64]
    ) -> None:
        """A control step ended that is not recorded: it says that at least."""
        self._take_in(self._log.step, ends, reward, episode_ids)

    def _take_in(
        self, step: int, ends: Ends | None, reward: NDArray[Any], episode_ids: NDArray[np.int64]
    ) -> None:
        """Write how episodes ended in a control step, if some did."""
        parts = self._episodes.add(step, reward, episode_ids, ends)
        if parts is not None:
            self._write(step, EPISODE_TOPIC, parts)

    def _roll(self, step: int) -> None:
        """Go on in another file with this control step."""
        self._seen.finish()
        part = self.file.part + 1
        name = part_name(self.file.name, part)

        def last(file: LogFile) -> None:
            file.metadata(METADATA_END, {"steps": str(step), "next": name})

        self._manifest.closed(step, self.file.roll(name, last))
        self._write_head(part, step)
        self._manifest.begun(name, step)
        self._manifest.write(complete=False)

    def _finish(self, steps: int) -> None:
        """The last call: the log has so many control steps."""
        self._seen.finish()
        self.file.metadata(METADATA_END, {"steps": str(steps)})

        def whole(nbytes: int) -> None:
            if self.file.part:
                self._manifest.closed(steps, nbytes)
                self._manifest.write(complete=True)

        self.file.finished = whole


def _write_layout(folder: int, text: str) -> None:
    """Put the viewer's layout beside the log, unless there is one."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    try:
        descriptor = os.open(LAYOUT_FILE, flags, 0o666, dir_fd=folder)
    except FileExistsError:
        return
    with open(descriptor, "w") as stream:
        stream.write(text)
