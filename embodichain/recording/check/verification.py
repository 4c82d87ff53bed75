"""`verify` simulates a log again from the file alone, and compares the states bit for bit.

Before that it checks every byte of the file (`byte_check`); of a damaged one nothing is simulated.

Physics of another engine than MuJoCo's own is compared within `TOLERANCE`.

It runs no terms, tasks or user code: the file contains the model and everything that was written
to the simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import EnvIndex
from embodichain.recording.check.byte_check import ByteReport, Damage, check_bytes
from embodichain.recording.format.attachments import (
    approximate_model,
    check_rows,
    model_to_simulate,
    what_differs,
)
from embodichain.recording.format.header import MUJOCO, Header
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.parts import first_file
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.simulation import (
    TOLERANCE,
    Active,
    Difference,
    DifferenceFound,
    Simulation,
    always,
)
from embodichain.recording.read.trajectory import changes, outcomes, runs
from embodichain.utils.errors import ConfigError

__all__ = ["MOST_OUTSIDE", "Difference", "VerifyReport", "damaged", "simulate", "verify"]

Progress = Callable[[int], None]
MOST_OUTSIDE = 0.05
"""Share of results of another engine's physics that may differ by more than `TOLERANCE`: in
float32, bodies that just touch may not."""


@dataclass(frozen=True, slots=True)
class VerifyReport:
    """Result of `verify`: whether simulating a log again gives the recorded states.

    Attributes:
        path: The file.
        ok: Whether no byte of the log is damaged, the log is complete and has steps, and every
            state is identical bit for bit; in a log of another engine, whether writes and resets
            are, and physics is close (`MOST_OUTSIDE`).
        steps: Number of control steps simulated and compared.
        envs: Number of environments simulated.
        difference: The first difference, or None.
        problems: Other reasons why `ok` is False, one line each.
        largest_error: Approximate mode: component to largest absolute difference after one step.
        measured: Approximate mode: number of results of physics compared.
        outside: Number of these that differ by more than `TOLERANCE`.
        engine: What computed the recorded physics.
        has_writes: Whether the log has writes and resets; else only the states that they left.
        notes: Remarks that are not errors: where a recovered log ends, how this machine differs
            from the one that recorded the log, what of a log nothing covers.
        damage: Damaged parts of the files; then nothing was simulated.
    """

    path: Path
    ok: bool
    steps: int
    envs: int
    difference: Difference | None = None
    problems: list[str] = field(default_factory=list)
    largest_error: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    measured: int = 0
    outside: int = 0
    engine: str = MUJOCO
    has_writes: bool = True
    damage: list[Damage] = field(default_factory=list)

    def __str__(self) -> str:
        """Return the result, and every reason on its own line."""
        count = f"{self.steps} steps of {self.envs} environment{'s' if self.envs != 1 else ''}"
        if self.ok and self.engine == MUJOCO:
            return "\n".join([f"verified: {count} are identical to the bit", *self.notes])
        if self.ok:
            first = f"verified: {count}, recorded with {self.engine}"
            return "\n".join([first, *self._closeness(), *self.notes])
        if self.damage:
            return "\n".join(f"NOT verified: {problem}" for problem in self.problems)
        lines = [f"NOT verified ({count} compared)"]
        if self.difference is not None:
            lines.append(f"first difference: {self.difference}")
        lines += self.problems
        if self.largest_error and self.engine == MUJOCO:
            errors = ", ".join(f"{k} {v:.3g}" for k, v in self.largest_error.items())
            lines.append(f"approximate only: largest difference after one step: {errors}")
        elif self.engine != MUJOCO:
            lines += self._closeness()
        lines += self.notes
        return "\n".join(lines)

    def _closeness(self) -> list[str]:
        """How close recorded results of physics are to MuJoCo's."""
        errors = ", ".join(f"{k} {v:.3g}" for k, v in self.largest_error.items())
        bounds = ", ".join(f"{k} {v:g}" for k, v in TOLERANCE.items())
        checked = "writes and resets are identical to the bit"
        unchecked = "the log has states, not writes: resets and events are not checked"
        return [
            checked if self.has_writes else unchecked,
            f"of {self.measured} results of physics, {self.outside} differ from MuJoCo's by more "
            f"than {bounds} (largest: {errors or 'none'})",
        ]


def verify(
    path: str | Path,
    env: int | None = None,
    episode: int | None = None,
    num_threads: int = 0,
    progress: Progress | None = None,
    images: bool = False,
) -> VerifyReport:
    """Check every byte of a log, simulate it again, and compare every row bit for bit.

    Args:
        path: The log: a file, the manifest of several files, or a run's folder.
        env: Only this environment; None is all.
        episode: Only this episode of the selected environments; None is all.
        num_threads: Physics threads; 0 is all cores. The result does not depend on it.
        progress: Called with the number of control steps done.
        images: If all states are identical: also draw the first picture of each episode again, as
            each camera that was read draws it, and compare its hash.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP, or `env` or `episode` is not in it,
            or `images` are of another engine than MuJoCo's.
        LogError: If it is not an embodichain log.
        RenderError: If `images` cannot be drawn here.
    """
    checked = check_bytes(path)
    if checked.damage:
        return damaged(first_file(path), checked)
    return simulate(path, checked, env, episode, num_threads, progress, images)


def damaged(path: Path, checked: ByteReport) -> VerifyReport:
    """The report of a log with damaged bytes; nothing of what they say is in it."""
    return VerifyReport(path, False, 0, 0, problems=[checked.problem], damage=checked.damage)


def simulate(
    path: str | Path,
    checked: ByteReport,
    env: int | None = None,
    episode: int | None = None,
    num_threads: int = 0,
    progress: Progress | None = None,
    images: bool = False,
) -> VerifyReport:
    """What `verify` does once the bytes were `checked`."""
    if images and episode is not None:
        raise ConfigError("pictures are compared in all episodes: leave the episode out")
    with LogReader(path) as reader:
        header = reader.require_header()
        if images and header.engine != MUJOCO:
            raise ConfigError(
                f"pictures of {header.engine} are not compared: its poses are float32"
            )
        selected = _select(header, env)
        report = VerifyReport(
            *(reader.path, False, 0, len(selected)),
            engine=header.engine,
            has_writes=header.has_writes,
        )
        cannot = header.unverifiable or header.unknown_engine
        if cannot:
            return replace(report, problems=[cannot])
        model, exact, problems = _model(reader)
        if model is not None:
            active = always(len(selected))
            if episode is not None:
                active = _episode(reader, selected, episode)
            how = model, selected, active, exact, num_threads, header.engine == MUJOCO
            report = _follow(reader, how, replace(report, problems=problems), progress)
            if images and report.ok:
                report = _compare_pictures(report, reader, model, env)
        else:
            report = replace(report, problems=problems)
        report = _with_notes(report, reader)
        return replace(report, notes=[*report.notes, *([checked.note] if checked.note else [])])


def _compare_pictures(
    report: VerifyReport, reader: LogReader, model: mujoco.MjModel, env: int | None
) -> VerifyReport:
    from embodichain.recording.views.pictures import compare

    try:
        equal, problems = compare(reader, model, env)
    except LogError as error:
        equal = 0
        problems = [str(error).removeprefix(f"{reader.path}: ")]
    note = f"the first pictures of episodes: {equal} are identical to the byte"
    return replace(
        report, ok=not problems, problems=problems, notes=[*report.notes, *([note] * (equal > 0))]
    )


def _with_notes(report: VerifyReport, reader: LogReader) -> VerifyReport:
    """If physics differs, add notes on how this machine differs, and how the log can be used."""
    header = reader.require_header()
    if report.difference is None and header.mujoco_version == mujoco.__version__:
        return report
    try:
        found = what_differs(header, reader.attachment("versions.json"))
    except LogError:
        found = what_differs(header, None)
    if not found:
        found = ["MuJoCo, processor and platform are the recorded ones: the file was changed"]
    return replace(report, notes=[*report.notes, *found, _still_good_for(header)])


def _still_good_for(header: Header) -> str:
    """What the log can still be used for if physics differs."""
    if header.keyframe_every and header.mujoco_version != mujoco.__version__:
        what = f"every {header.keyframe_every}th state, which was recorded, can be read"
        return f"{what} (recording.open); those between need mujoco=={header.mujoco_version}"
    return "its recorded states can be played all the same: replay --view, replay --video, export"


def _select(header: Header, env: int | None) -> EnvIndex:
    if env is None:
        return np.arange(header.num_envs, dtype=np.int64)
    header.check_env(env)
    return np.array([env], np.int64)


def _model(reader: LogReader) -> tuple[mujoco.MjModel | None, bool, list[str]]:
    """The model to simulate, whether it is exactly the recorded one, and the problems."""
    header = reader.require_header()
    exact = header.mujoco_version == mujoco.__version__
    problems = []
    if not exact:
        problems.append(
            f"recorded with MuJoCo {header.mujoco_version}, this is {mujoco.__version__}: "
            f"bit-exact replay needs mujoco=={header.mujoco_version}"
        )
    try:
        if exact:
            return model_to_simulate(header, reader.attachment), True, []
        model = approximate_model(header, reader.attachment("scene.mjz"))
        check_rows(header, model)
    except LogError as error:
        return None, False, [*problems, str(error).removeprefix(f"{reader.path}: ")]
    problems[0] += "; simulated approximately from scene.mjz (its XML has 6 digits)"
    if header.keyframe_every:
        problems[0] += f" between keyframes, up to {header.keyframe_every} steps at a time"
    return model, False, problems


def _episode(reader: LogReader, selected: EnvIndex, episode: int) -> Active:
    """Steps of an episode of the selected environments, found in a separate pass over the log."""
    masks: dict[int, NDArray[np.bool_]] = {}
    last = -1
    try:
        for run in runs(reader, wanted=outcomes):
            if run.steps:
                ids = run.calls[-1].arrays["episode_ids"][:, selected]
                masks |= zip(range(run.first, run.first + run.count), ids == episode, strict=True)
                last = max(last, int(ids.max()))
    except LogError:
        pass  # `_follow` will report it
    if not any(mask.any() for mask in masks.values()):
        raise ConfigError(f"no episode {episode} in the log: there are 0 to {last}")
    nothing = np.zeros(len(selected), np.bool_)
    return lambda step: masks.get(step, nothing)


def _follow(
    reader: LogReader,
    how: tuple[mujoco.MjModel, EnvIndex, Active, bool, int, bool],
    report: VerifyReport,
    progress: Progress | None,
) -> VerifyReport:
    """Simulate and compare up to the first difference or the end; `how`: `Simulation`'s args."""
    steps = 0
    last_step = reader.require_header().first_step - 1
    difference = None
    error = ""
    active = how[2]
    largest: dict[str, float] = {}
    simulation = None
    try:
        for run in runs(reader, wanted=lambda kind: changes(kind) or outcomes(kind)):
            if simulation is None:  # the first run is a start, which proves the header's num_envs
                simulation = Simulation(reader, *how)
                largest = simulation.largest_error
            if run.of_kind("start"):
                simulation.begin(run)
                continue
            for t in range(run.count):
                for call in run.calls:
                    simulation.apply(run.first + t, call, t)
                if run.steps:
                    last_step = run.first + t
                    steps += bool(active(last_step).any())
                    if progress is not None:
                        progress(steps)
    except DifferenceFound as found:
        difference = found.difference
    except LogError as damage:
        error = f"after {steps} steps: {str(damage).removeprefix(f'{reader.path}: ')}"
    report = replace(report, steps=steps, difference=difference, largest_error=largest)
    if simulation is not None:
        report = replace(report, measured=simulation.measured, outside=simulation.outside)
    if difference is not None or error:
        return replace(report, problems=[*report.problems, *([error] if error else [])])
    return _at_the_end(reader, report, last_step)


def _at_the_end(reader: LogReader, report: VerifyReport, last_step: int) -> VerifyReport:
    """Add to the report what is missing at the end of the log, and its notes."""
    ends = f"the log ends after step {last_step}"
    if last_step < 0:
        ends = "the log ends before its first step was complete"
    problems = [*report.problems, *([f"{ends}: {reader.cut}"] if reader.cut else [])]
    if not report.steps and not reader.cut:
        problems.append("the log has no control step: there is nothing to compare")
    if report.engine != MUJOCO and report.outside > MOST_OUTSIDE * report.measured:
        share = f"{report.outside / report.measured:.1%}"
        message = f"{share} of the results of physics are not MuJoCo's"
        problems.append(f"{message}; at most {MOST_OUTSIDE:.0%} are expected")
    notes = [f"{ends}: {reader.recovered}"] if reader.recovered and reader.complete else []
    notes += [note for note in (reader.part_note, reader.require_header().every_note) if note]
    return replace(report, ok=not problems, problems=problems, notes=notes)
