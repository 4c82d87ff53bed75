"""What every file of a log begins with, and how a log goes on in another file."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco

from embodichain.recording.attachments import Attachment, model_digest
from embodichain.recording.columns import RowColumns
from embodichain.recording.header import METADATA, METADATA_END, Header, why_unverifiable
from embodichain.recording.options import RecordLike
from embodichain.recording.parts import Manifest, part_name
from embodichain.recording.writer import McapThread

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["LogHead", "RecordStats", "Rolling", "header_of"]


@dataclass(frozen=True, slots=True)
class RecordStats:
    """What a recorder has written.

    Attributes:
        path: The file; the first one, if the log goes on in others.
        steps: Control steps.
        nbytes: Size of the log so far.
    """

    path: Path
    steps: int
    nbytes: int


def header_of(
    env: BaseEnv, options: RecordLike, columns: RowColumns, mjb: bytes, task: str, start_ns: int
) -> Header:
    """The metadata of a recording that begins.

    Args:
        env: What is recorded.
        options: What of it.
        columns: Columns of a row that are written.
        mjb: The compiled model.
        task: The task's name.
        start_ns: Wall clock.
    """
    model = env.sim.engine.model
    return Header(
        task=task,
        seed=int(env.seed_value),
        num_envs=env.num_envs,
        control_dt=float(env.step_dt),
        physics_dt=float(env.physics_dt),
        substeps=int(env.sim_steps_per_control),
        start_ns=start_ns,
        mujoco_version=mujoco.__version__,
        model=model_digest(mjb),
        state=options.state,
        state_sig=int(mujoco.mjtState.mjSTATE_INTEGRATION),
        nstate=columns.nstate,
        columns=columns.kept,
        layout={name: (s.start, s.stop) for name, s in columns.layout.items()},
        view_envs=[int(i) for i in options.view_envs],
        unverifiable=why_unverifiable(model, options.state),
        keyframe_every=options.keyframe_every if options.state == "keyframes" else 0,
        every=options.every,
        log_id=uuid.uuid4().hex,
    )


class LogHead:
    """Attachments and metadata; written on the background thread.

    Args:
        header: Of the first file.
        make: Makes the attachments.
        again: Whether they are needed more than once.
    """

    def __init__(self, header: Header, make: Callable[[], list[Attachment]], again: bool) -> None:
        self.header = header
        self._make, self._again = make, again
        self._made: list[Attachment] = []

    def write(self, file: McapThread, part: int = 0, first_step: int = 0) -> None:
        """Write them at the start of a file."""
        attachments = self._made or self._make()
        if self._again:  # files of the scene may be gone by then
            self._made = attachments
        for name, media_type, data in attachments:
            file.attach(name, media_type, data, self.header.start_ns)
        header = replace(self.header, part=part, first_step=first_step)
        file.metadata(METADATA, header.to_metadata())


class Rolling:
    """Closes a file that has become too large, and begins the next, on the background thread.

    Args:
        file: The log.
        head: What every file begins with.
        max_bytes: Size after which the next one begins. A file holds at least as much of the run
            as it has attachments.
    """

    def __init__(self, file: McapThread, head: LogHead, max_bytes: float) -> None:
        header = head.header
        self._file, self._head, self._max = file, head, max_bytes
        self._manifest = Manifest(
            file.folder, file.path.name, header.log_id, header.period_ns * 1e-9
        )
        self._asked = 0
        self._head_bytes = 0

    @property
    def due(self) -> bool:
        """Whether the file has reached its size; asked on the simulation's thread."""
        file = self._file
        here = file.part == self._asked and self._head_bytes > 0
        return here and file.size > max(self._max, 2 * self._head_bytes)

    def began(self, file: McapThread) -> None:
        """The state at the start of the file has been written."""
        self._head_bytes = file.size

    def job(self, step: int) -> Callable[[McapThread], None]:
        """What makes the log go on in another file with control step `step`."""
        self._asked += 1
        part = self._asked
        name = part_name(self._file.path.name, part)

        def last(file: McapThread) -> None:
            file.metadata(METADATA_END, {"steps": str(step), "next": name})

        def go_on(file: McapThread) -> None:
            self._head_bytes = 0
            self._manifest.closed(step, file.roll(name, last))
            self._head.write(file, part, step)
            self._manifest.begun(name, step)
            self._manifest.write(complete=False)

        return go_on

    def finish(self, steps: int) -> Callable[[McapThread], None]:
        """What completes the manifest, if there is one, when the last file is whole."""

        def whole(nbytes: int) -> None:
            if self._file.part:
                self._manifest.closed(steps, nbytes)
                self._manifest.write(complete=True)

        def job(file: McapThread) -> None:
            file.finished = whole

        return job
