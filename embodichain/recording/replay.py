"""`inspect` says what is in a log; `verify` simulates it again, from the file alone.

No term, no task and no user's code takes part: the model is in the file, and so is everything that
was written to the simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import EnvIndex
from embodichain.recording.header import Header, LogError
from embodichain.recording.messages import State, StepOutcome
from embodichain.recording.parts import first_file
from embodichain.recording.provenance import what_can_be_played, what_differs
from embodichain.recording.reader import LogReader
from embodichain.recording.recorded_model import approximate_model, check_rows, exact_model
from embodichain.recording.resimulate import ActiveSteps, Found, Resimulation
from embodichain.recording.summary import LogSummary, summarize
from embodichain.recording.verify_report import VerifyReport
from embodichain.recording.wire import WireError
from embodichain.utils.errors import ConfigError

__all__ = ["inspect", "verify"]

Progress = Callable[[int], None]


def inspect(path: str | Path) -> LogSummary:
    """What is in a log; a broken one is read up to where it is good, and its `warnings` say so.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it is not a log of embodichain's.
    """
    return summarize(path)


def verify(
    path: str | Path,
    env: int | None = None,
    episode: int | None = None,
    num_threads: int = 0,
    progress: Progress | None = None,
) -> VerifyReport:
    """Simulate a log again and compare every row, bit for bit.

    Args:
        path: The log: a file, the manifest of several, or a run's folder.
        env: Only this environment; None is all.
        episode: Only this episode of every environment looked at; None is all.
        num_threads: Physics threads; 0 is all cores. No result depends on it.
        progress: Called with the number of control steps done.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP, or `env` or `episode` is not in it.
        LogError: If it is not a log of embodichain's.
    """
    path = first_file(path)
    header, attachments = _head(path)
    selected = _select(header, env)
    if header.unverifiable:
        return VerifyReport(path, False, 0, len(selected), problems=[header.unverifiable])
    model, exact, problems = _model(header, attachments)
    if model is None:
        report = VerifyReport(path, False, 0, len(selected), problems=problems)
        return _with_notes(report, header, attachments)
    active = _everything(len(selected)) if episode is None else _episode(path, selected, episode)
    simulation = Resimulation(header, model, selected, active, exact, num_threads)
    report = _follow(path, simulation, len(selected), problems, progress)
    return _with_notes(report, header, attachments)


def _with_notes(
    report: VerifyReport, header: Header, attachments: dict[str, bytes]
) -> VerifyReport:
    """Say what is another here, where physics differs, and what the log is still good for."""
    if report.difference is None and header.mujoco_version == mujoco.__version__:
        return report
    found = what_differs(header, attachments.get("versions.json"))
    if not found:
        found = ["MuJoCo, processor and platform are the recorded ones: the file was changed"]
    return replace(report, notes=[*report.notes, *found, what_can_be_played(header)])


def _head(path: Path) -> tuple[Header, dict[str, bytes]]:
    """What precedes the first rows; an engine of that many environments is believed then."""
    with LogReader(path) as reader:
        for topic, message in reader.messages():
            header = reader.require_header()
            if topic == "/sim/state":
                _check_rows(header, message.data)
                break
        return reader.require_header(), reader.attachments


def _check_rows(header: Header, data: bytes) -> None:
    try:
        rows = State.decode(data).rows
    except WireError:
        return  # following the log will end here, and say so
    if len(rows) > header.num_envs or rows.shape[1] > header.nstate:
        raise LogError(f"the first rows, {rows.shape}, are not of {header.num_envs} environments")


def _select(header: Header, env: int | None) -> EnvIndex:
    if env is None:
        return np.arange(header.num_envs, dtype=np.int64)
    if not 0 <= env < header.num_envs:
        raise ConfigError(f"no environment {env} in the log: there are 0 to {header.num_envs - 1}")
    return np.array([env], np.int64)


def _model(
    header: Header, attachments: dict[str, bytes]
) -> tuple[mujoco.MjModel | None, bool, list[str]]:
    """The model to simulate, whether it is the recorded one to the bit, and what is wrong."""
    if header.mujoco_version != mujoco.__version__:
        return _approximate_model(header, attachments)
    mjb = attachments.get("model.mjb")
    if mjb is None:
        return None, False, ["the log has no attachment model.mjb"]
    try:
        return exact_model(header, mjb), True, []
    except LogError as error:
        return None, False, [str(error)]


def _approximate_model(
    header: Header, attachments: dict[str, bytes]
) -> tuple[mujoco.MjModel | None, bool, list[str]]:
    problem = (
        f"recorded with MuJoCo {header.mujoco_version}, this is {mujoco.__version__}: "
        f"bit-exact replay needs mujoco=={header.mujoco_version}"
    )
    archive = attachments.get("scene.mjz")
    if archive is None:
        return None, False, [problem, "the log has no attachment scene.mjz to fall back to"]
    try:
        model = approximate_model(header, archive)
        check_rows(header, model)
    except LogError as error:
        return None, False, [problem, str(error)]
    problem += "; simulated approximately from scene.mjz (its XML has 6 digits)"
    if header.keyframe_every:
        problem += f" between keyframes, up to {header.keyframe_every} steps at a time"
    return model, False, [problem]


def _everything(n: int) -> ActiveSteps:
    mask = np.ones(n, np.bool_)
    return lambda step: mask


def _episode(path: Path, selected: EnvIndex, episode: int) -> ActiveSteps:
    """Steps that belong to an episode of the selected environments, found in a pass of its own."""
    masks: dict[int, NDArray[np.bool_]] = {}
    last = -1
    with LogReader(path) as reader:
        for topic, message in reader.messages():
            if topic == "/sim/step":
                try:
                    outcome = StepOutcome.decode(message.data)
                    ids = outcome.episode_ids[selected]
                except (WireError, IndexError):
                    break  # where following it will end too, and say so
                masks[outcome.step] = ids == episode
                last = max(last, int(ids.max()))
    if not any(mask.any() for mask in masks.values()):
        raise ConfigError(f"no episode {episode} in the log: there are 0 to {last}")
    nothing = np.zeros(len(selected), np.bool_)
    return lambda step: masks.get(step, nothing)


def _follow(
    path: Path,
    simulation: Resimulation,
    envs: int,
    problems: list[str],
    progress: Progress | None,
) -> VerifyReport:
    handlers = {
        "/sim/write": simulation.on_write,
        "/sim/state": simulation.on_state,
        "/sim/step": simulation.on_step,
        "/sim/physics": simulation.on_call,
    }
    difference = None
    notes: list[str] = []
    with LogReader(path) as reader:
        try:
            for topic, message in reader.messages():
                handler = handlers.get(topic)
                if handler is not None:
                    handler(message.data)
                    if progress is not None and topic == "/sim/step":
                        progress(simulation.steps)
            simulation.finish()
        except Found as found:
            difference = found.difference
        except (LogError, WireError) as error:
            problems = [*problems, f"after {simulation.steps} steps: {error}"]
        else:
            problems = [*problems, *_end(reader, simulation.last_step)]
            if reader.recovered and reader.complete:
                notes.append(f"the log ends {_where(simulation.last_step)}: {reader.recovered}")
            said = reader.part_note, reader.require_header().every_note
            notes += [note for note in said if note]
    ok = difference is None and not problems
    errors = simulation.largest_error
    return VerifyReport(path, ok, simulation.steps, envs, difference, problems, errors, notes)


def _end(reader: LogReader, last_step: int) -> list[str]:
    """What is missing at the end of a log."""
    if not reader.complete:
        return [f"the log ends {_where(last_step)}: {reader.damage or 'its end is missing'}"]
    if not reader.finished and not reader.recovered:
        return [f"the log ends {_where(last_step)}: the recorder did not close it"]
    return []


def _where(last_step: int) -> str:
    return f"after step {last_step}" if last_step >= 0 else "before its first step was complete"
