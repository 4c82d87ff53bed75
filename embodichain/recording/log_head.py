"""What a log begins with: plain data, made beside the simulation and written by another process."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco

from embodichain.recording.attachments import Attachment, model_digest
from embodichain.recording.columns import RowColumns
from embodichain.recording.foxglove.view_spec import ViewSpec
from embodichain.recording.header import Header, why_unverifiable
from embodichain.recording.options import RecordLike

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["LogHead", "RecordStats", "header_of"]


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


@dataclass(frozen=True, slots=True)
class LogHead:
    """What has to be known to write a log.

    Attributes:
        header: Metadata of the first file.
        attachments: Of every file; the compiled model is among them.
        views: What people look at.
        layout: The viewer's layout, as text, for a file beside the log.
        rolls: Whether the log may go on in another file.
    """

    header: Header
    attachments: list[Attachment]
    views: ViewSpec
    layout: str
    rolls: bool = False


def header_of(
    env: ObservedEnv, options: RecordLike, columns: RowColumns, mjb: bytes, task: str, start_ns: int
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
