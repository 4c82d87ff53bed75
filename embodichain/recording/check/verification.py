"""`verify` simulates a log again from the file alone, and compares the states bit for bit.

Before that it checks every byte of the file (`byte_check`); it does not simulate a damaged file.

Physics of another engine than MuJoCo's own is compared within `TOLERANCE`.

It runs no terms, tasks or user code: the file contains the model and everything that was written
to the simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.engine_register import find_recorded
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
from embodichain.utils.array_types import EnvIds
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
        largest_error: Approximate mode: component -> largest absolute difference after one step.
        measured: Approximate mode: number of results of physics compared.
        outside: Number of these that differ by more than `TOLERANCE`.
        engine: What computed the recorded physics.
        has_writes: Whether the log has writes and resets; else only the states that they left.
        notes: Remarks that are not errors: where a recovered log ends, how this machine differs
            from the one that recorded the log, how many bytes no checksum covers.
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

    @property
    def is_exact(self) -> bool:
        """Whether MuJoCo's results are those of `engine` to the bit."""
        kind = find_recorded(self.engine)
        return kind is not None and kind.is_exact

    def __str__(self) -> str:
        """Return the result, and every reason on its own line."""
        environments = "environment" if self.envs == 1 else "environments"
        count = f"{self.steps} steps of {self.envs} {environments}"
        if self.ok and self.is_exact:
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
        if self.largest_error and self.is_exact:
            errors = self._largest_errors()
            lines.append(f"approximate only: largest difference after one step: {errors}")
        elif not self.is_exact:
            lines += self._closeness()
        lines += self.notes
        return "\n".join(lines)

    def _closeness(self) -> list[str]:
        """How close recorded results of physics are to MuJoCo's."""
        writes = "writes and resets are identical to the bit"
        if not self.has_writes:
            writes = "the log has states, not writes: resets and events are not checked"
        bounds = ", ".join(f"{name} {bound:g}" for name, bound in TOLERANCE.items())
        physics = (
            f"of {self.measured} results of physics, {self.outside} differ from MuJoCo's by more "
            f"than {bounds} (largest: {self._largest_errors() or 'none'})"
        )
        return [writes, physics]

    def _largest_errors(self) -> str:
        return ", ".join(f"{name} {error:.3g}" for name, error in self.largest_error.items())


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
    return simulate(
        path,
        checked,
        env=env,
        episode=episode,
        num_threads=num_threads,
        progress=progress,
        images=images,
    )


def damaged(path: Path, checked: ByteReport) -> VerifyReport:
    """The report of a log with damaged bytes: it says nothing that these bytes say."""
    return VerifyReport(
        path,
        ok=False,
        steps=0,
        envs=0,
        problems=[checked.problem],
        damage=checked.damage,
    )


def simulate(
    path: str | Path,
    checked: ByteReport,
    env: int | None = None,
    episode: int | None = None,
    num_threads: int = 0,
    progress: Progress | None = None,
    images: bool = False,
) -> VerifyReport:
    """Do what `verify` does once the bytes were checked.

    Args:
        path: The log.
        checked: The result of `check_bytes`, without damage.
        env: Only this environment; None is all.
        episode: Only this episode of the selected environments; None is all.
        num_threads: Physics threads; 0 is all cores.
        progress: Called with the number of control steps done.
        images: Whether to compare pictures too.
    """
    if images and episode is not None:
        raise ConfigError("pictures are compared in all episodes: leave the episode out")
    with LogReader(path) as reader:
        header = reader.require_header()
        if images and not header.is_exact:
            raise ConfigError(
                f"pictures of {header.engine} are not compared: its poses are float32"
            )
        env_ids = _selected_envs(header, env)
        report = VerifyReport(
            path=reader.path,
            ok=False,
            steps=0,
            envs=len(env_ids),
            engine=header.engine,
            has_writes=header.has_writes,
        )
        unverifiable = header.unverifiable or header.unknown_engine
        if unverifiable:
            return replace(report, problems=[unverifiable])
        loaded = _load_model(reader)
        report = replace(report, problems=loaded.problems)
        if loaded.model is not None:
            if episode is None:
                active = always(len(env_ids))
            else:
                active = _steps_of_episode(reader, env_ids, episode)
            start_simulation = partial(
                Simulation,
                reader,
                loaded.model,
                env_ids=env_ids,
                active=active,
                exact=loaded.exact,
                num_threads=num_threads,
                repeats=header.is_exact,
            )
            report = _follow(reader, start_simulation, report, progress)
            if images and report.ok:
                report = _compare_pictures(report, reader, loaded.model, env)
        notes = [*report.notes, *_notes_on_difference(report, reader)]
        if checked.note:
            notes.append(checked.note)
        return replace(report, notes=notes)


def _compare_pictures(
    report: VerifyReport, reader: LogReader, model: mujoco.MjModel, env: int | None
) -> VerifyReport:
    # Pictures need a renderer, which most verifications do without.
    from embodichain.recording.views.pictures import compare

    try:
        num_equal, problems = compare(reader, model, env)
    except LogError as error:
        num_equal = 0
        problems = [_without_path(error, reader)]
    notes = list(report.notes)
    if num_equal:
        notes.append(f"the first pictures of episodes: {num_equal} are identical to the byte")
    return replace(report, ok=not problems, problems=problems, notes=notes)


def _without_path(error: LogError, reader: LogReader) -> str:
    """The text of an error, for a report that names the log itself."""
    return str(error).removeprefix(f"{reader.path}: ")


def _notes_on_difference(report: VerifyReport, reader: LogReader) -> list[str]:
    """If physics differs: how this machine differs, and how the log can be used nevertheless."""
    header = reader.require_header()
    if report.difference is None and header.mujoco_version == mujoco.__version__:
        return []
    try:
        reasons = what_differs(header, reader.attachment("versions.json"))
    except LogError:
        reasons = what_differs(header, None)
    if not reasons:
        reasons = ["MuJoCo, processor and platform are the recorded ones: the file was changed"]
    return [*reasons, _remaining_use(header)]


def _remaining_use(header: Header) -> str:
    """How the log can be used although physics differs."""
    if header.keyframe_every and header.mujoco_version != mujoco.__version__:
        keyframes = f"every {header.keyframe_every}th state, which was recorded, can be read"
        return f"{keyframes} (recording.open); those between need mujoco=={header.mujoco_version}"
    return "its recorded states can be played all the same: replay --view, replay --video, export"


def _selected_envs(header: Header, env: int | None) -> EnvIds:
    if env is None:
        return np.arange(header.num_envs, dtype=np.int64)
    header.check_env(env)
    return np.array([env], np.int64)


class _LoadedModel(NamedTuple):
    """The model that is simulated.

    Attributes:
        model: The model; None if it cannot be loaded.
        exact: Whether it is exactly the recorded one.
        problems: Why the log is not verified with it.
    """

    model: mujoco.MjModel | None
    exact: bool
    problems: list[str]


def _load_model(reader: LogReader) -> _LoadedModel:
    header = reader.require_header()
    if header.mujoco_version == mujoco.__version__:
        try:
            model = model_to_simulate(header, reader.attachment)
        except LogError as error:
            return _LoadedModel(None, exact=False, problems=[_without_path(error, reader)])
        return _LoadedModel(model, exact=True, problems=[])
    problem = (
        f"recorded with MuJoCo {header.mujoco_version}, this is {mujoco.__version__}: "
        f"bit-exact replay needs mujoco=={header.mujoco_version}"
    )
    try:
        model = approximate_model(header, reader.attachment("scene.mjz"))
        check_rows(header, model)
    except LogError as error:
        return _LoadedModel(None, exact=False, problems=[problem, _without_path(error, reader)])
    problem += "; simulated approximately from scene.mjz (its XML has 6 digits)"
    if header.keyframe_every:
        problem += f" between keyframes, up to {header.keyframe_every} steps at a time"
    return _LoadedModel(model, exact=False, problems=[problem])


def _steps_of_episode(reader: LogReader, env_ids: EnvIds, episode: int) -> Active:
    """Steps of an episode of the selected environments, from a separate pass over the log."""
    masks: dict[int, NDArray[np.bool_]] = {}
    last_episode = -1
    try:
        for run in runs(reader, is_read=outcomes):
            if not run.steps:
                continue
            episode_ids = run.calls[-1].arrays["episode_ids"][:, env_ids]
            for t in range(run.count):
                masks[run.first + t] = episode_ids[t] == episode
            last_episode = max(last_episode, int(episode_ids.max()))
    except LogError:
        pass  # `_follow` reads the same messages, and reports the damage
    if not any(mask.any() for mask in masks.values()):
        raise ConfigError(f"no episode {episode} in the log: there are 0 to {last_episode}")
    no_environment = np.zeros(len(env_ids), np.bool_)
    return lambda step: masks.get(step, no_environment)


def _follow(
    reader: LogReader,
    start_simulation: Callable[[], Simulation],
    report: VerifyReport,
    progress: Progress | None,
) -> VerifyReport:
    """Simulate and compare up to the first difference or the end of the log."""
    steps = 0
    last_step = reader.require_header().first_step - 1
    difference = None
    problems = list(report.problems)
    simulation = None
    try:
        for run in runs(reader, is_read=lambda kind: changes(kind) or outcomes(kind)):
            if simulation is None:
                # The first run is a start. Only its size proves the header's number of
                # environments, for which the simulation allocates memory.
                simulation = start_simulation()
            if run.of_kind("start"):
                simulation.begin(run)
                continue
            for t in range(run.count):
                for call in run.calls:
                    simulation.apply(run.first + t, call, t)
                if run.steps:
                    last_step = run.first + t
                    steps += simulation.is_compared(last_step)
                    if progress is not None:
                        progress(steps)
    except DifferenceFound as error:
        difference = error.difference
    except LogError as error:
        problems.append(f"after {steps} steps: {_without_path(error, reader)}")
    report = replace(report, steps=steps, difference=difference)
    if simulation is not None:
        report = replace(
            report,
            largest_error=simulation.largest_error,
            measured=simulation.measured,
            outside=simulation.outside,
        )
    if difference is not None or len(problems) > len(report.problems):
        return replace(report, problems=problems)
    return _at_the_end(reader, report, last_step)


def _at_the_end(reader: LogReader, report: VerifyReport, last_step: int) -> VerifyReport:
    """Add to the report what is missing at the end of the log, and its notes."""
    if last_step < 0:
        end = "the log ends before its first step was complete"
    else:
        end = f"the log ends after step {last_step}"
    problems = list(report.problems)
    if reader.cut:
        problems.append(f"{end}: {reader.cut}")
    elif not report.steps:
        problems.append("the log has no control step: there is nothing to compare")
    if not report.is_exact and report.outside > MOST_OUTSIDE * report.measured:
        share = f"{report.outside / report.measured:.1%}"
        message = f"{share} of the results of physics are not MuJoCo's"
        problems.append(f"{message}; at most {MOST_OUTSIDE:.0%} are expected")
    notes = []
    if reader.recovered and reader.complete:
        notes.append(f"{end}: {reader.recovered}")
    for note in (reader.part_note, reader.require_header().every_note):
        if note:
            notes.append(note)
    return replace(report, ok=not problems, problems=problems, notes=notes)
