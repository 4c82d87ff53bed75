"""`open`: a log as metadata, config, model, episodes and arrays, read when they are asked for."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import mujoco
import numpy as np
import yaml
from numpy.typing import NDArray

from embodichain.lab.gym.envs.snapshot import Snapshot
from embodichain.recording import wire
from embodichain.recording.arrays import LogArrays
from embodichain.recording.chunks import ChunkFile
from embodichain.recording.episode_log import TOPIC as EPISODE_TOPIC
from embodichain.recording.episode_log import by_episode, decode_ends
from embodichain.recording.episodes import LogEpisode, find_episodes, of_ended, with_unrecorded
from embodichain.recording.events import LogEvent
from embodichain.recording.gather import OUTCOMES, Gatherer, Steps, first_step
from embodichain.recording.header import Header, LogError
from embodichain.recording.messages import StepOutcome, WriteRecord
from embodichain.recording.metrics import read_metrics
from embodichain.recording.model_columns import Column, state_columns
from embodichain.recording.rebuild import FilledFile
from embodichain.recording.recorded_model import approximate_model, exact_model
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = ["Log", "open"]

T = TypeVar("T")


def open(path: str | Path, simulate: bool = False) -> Log:
    """Open a log; its messages are read when they are asked for. Close it, or use `with`.

    A broken file is read up to where it is good: `complete` is False, and `warnings` says why.

    Args:
        path: A log, the manifest of one in several files, or the folder of a run. The first file
            of several stands for all of them; any other is opened alone.
        simulate: Whether states between the keyframes of a log with `record.state=keyframes` are
            simulated again, from the file alone. Without it only keyframes are read.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it is not a log of embodichain's.
    """
    return Log(path, simulate)


class Log:
    """An open log.

    Attributes:
        path: The file.
        header: What was recorded and how: task, seed, num_envs, time steps, layout of states.
    """

    def __init__(self, path: str | Path, simulate: bool = False) -> None:
        self._file = ChunkFile(Path(path))
        self._simulate = simulate
        self.path = self._file.path
        try:
            self.header: Header = self._file.require_header()
            if not self.header.period_ns:
                raise LogError(f"{self.path}: a control step takes {self.header.control_dt} s")
        except LogError:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; what was read stays."""
        self._file.close()

    def __enter__(self) -> Log:
        """Return the log."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def __repr__(self) -> str:
        state = "complete" if self.complete else "INCOMPLETE"
        return f"<Log {self.path}: {self.task}, {self.num_envs} environments, {state}>"

    # -- what was recorded -------------------------------------------------------------------------

    @property
    def task(self) -> str:
        """Name of the task."""
        return self.header.task

    @property
    def seed(self) -> int:
        """The environments' seed."""
        return self.header.seed

    @property
    def num_envs(self) -> int:
        """N."""
        return self.header.num_envs

    @property
    def dt(self) -> float:
        """Seconds a control step."""
        return self.header.control_dt

    @property
    def complete(self) -> bool:
        """Whether the recorder closed the file and nothing damaged was met so far."""
        return self._file.complete and self._file.finished

    @property
    def warnings(self) -> list[str]:
        """What is missing or damaged, as far as it was met; empty for a complete log."""
        if not self._file.complete:
            why = self._file.damage or "its end is missing"
            return [f"incomplete: {why}; only what precedes can be read"]
        if self._file.recovered:
            return [f"recovered from a broken file: {self._file.recovered}"]
        if not self._file.finished:
            return ["the recorder did not close this log: its last steps may be missing"]
        return [self._file.part_note] if self._file.part_note else []

    @cached_property
    def versions(self) -> dict[str, str]:
        """Versions of what decides a run's bytes."""
        try:
            found: dict[str, str] = json.loads(self.attachment("versions.json"))
        except ValueError as error:
            raise LogError(f"{self.path}: versions.json is damaged: {error}") from error
        return found

    @property
    def config_yaml(self) -> str:
        """The resolved config, as it was written."""
        return self.attachment("config.yaml").decode()

    @cached_property
    def config(self) -> dict[str, Any]:
        """The resolved config as a tree."""
        try:
            tree = yaml.safe_load(self.config_yaml)
        except yaml.YAMLError as error:
            raise LogError(f"{self.path}: config.yaml is damaged: {error}") from error
        return tree or {}

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The recorded model: exact with the same MuJoCo, else compiled from the scene's XML.

        Raises:
            LogError: If it is missing, or this MuJoCo does not read it.
        """
        same = self.header.mujoco_version == mujoco.__version__
        data = self.attachment("model.mjb" if same else "scene.mjz")
        try:
            return (exact_model if same else approximate_model)(self.header, data)
        except LogError as error:
            raise LogError(f"{self.path}: {error}") from error

    @property
    def attachments(self) -> list[str]:
        """Names of the attachments."""
        return self._file.attachments

    def attachment(self, name: str) -> bytes:
        """Content of an attachment.

        Raises:
            LogError: If there is none of that name, or it is damaged.
        """
        return self._file.attachment(name)

    # -- arrays ------------------------------------------------------------------------------------

    @cached_property
    def columns(self) -> dict[str, list[Column]]:
        """Every field that `read` takes, with name and unit of its columns."""
        single = ("rewards", "terminated", "truncated", "episodes")
        found = {name: [Column(name, "")] for name in single}
        if self.header.state != "none":
            found = state_columns(self.model, self.header.layout) | found
            found["actions"] = [Column(str(i), "") for i in range(self._action_width())]
        return found

    def _action_width(self) -> int:
        """Columns of an action; 0 if no step is in the log."""
        first = next(self._decoded("/sim/step", StepOutcome.decode), None)
        return 0 if first is None else first.action.shape[-1]

    @property
    def _usual(self) -> list[str]:
        """Fields that are read when none are named: no hidden inputs of physics."""
        hidden = {"time", "qacc_warmstart", "qfrc_applied", "xfrc_applied", "eq_active"}
        return [name for name in self.columns if name not in hidden]

    def read(
        self,
        fields: str | Iterable[str] | None = None,
        env: int | Sequence[int] | None = None,
        episode: int | None = None,
        start: int = 0,
        stop: int | None = None,
    ) -> LogArrays:
        """Arrays of some fields, environments and steps; only the chunks they lie in are read.

        States are as physics received them: after every write of the step, controls included. Only
        complete steps are read. (The times of a step's state and reward differ by a step's length:
        the reward is of the state that followed.)

        Args:
            fields: Components of the state (`qpos`, `qvel`, `ctrl`, `mocap_pos`, ...), `actions`,
                `rewards`, `terminated`, `truncated`, `episodes`; None is all but `time`, applied
                forces and the solver's warm start.
            env: An environment, or several in ascending order; None is all.
            episode: Only this episode of the one environment that `env` names.
            start: First control step.
            stop: Control step that is no longer read; None is the end.

        Raises:
            ConfigError: If a field, environment or episode does not exist.
            LogError: If the log has no states, or says what cannot be.
        """
        self.header.require_states(self.path)
        names = self._fields(fields)
        span = Steps(start, stop)
        if episode is not None:
            span = self._span_of(env, episode, span)
        return self._gather(names, env, span).arrays(self.columns)

    def parts(
        self,
        fields: str | Iterable[str] | None = None,
        env: int | Sequence[int] | None = None,
        episode: int | None = None,
        start: int = 0,
        stop: int | None = None,
        steps: int = 1000,
    ) -> Iterator[LogArrays]:
        """What `read` gives, `steps` control steps at a time: for what does not fit into memory."""
        if steps < 1:
            raise ConfigError(f"parts of {steps} control steps: give 1 or more")
        names = self._fields(fields)
        if episode is not None:
            whole = self._span_of(env, episode, Steps(start, stop))
            start, stop = whole.start, whole.stop
        at: int | None = start
        while at is not None and (stop is None or at < stop):
            end = at + steps if stop is None else min(at + steps, stop)
            part = self.read(names, env, None, at, end)
            if len(part):
                yield part
            # Behind a gap of any length it goes on where there is a step.
            at = end if len(part) else first_step(self._file, Steps(end, stop))

    def _fields(self, fields: str | Iterable[str] | None) -> list[str]:
        if fields is None:
            return self._usual
        names = [fields] if isinstance(fields, str) else list(fields)
        for name in names:
            if name not in self.columns:
                hint = did_you_mean(name, self.columns)
                raise ConfigError(f"no field {name!r}.{hint} Fields: {', '.join(self.columns)}")
        return names

    def _envs(self, env: int | Sequence[int] | None) -> NDArray[np.int64]:
        if env is None:
            return np.arange(self.num_envs)
        ids = np.atleast_1d(np.asarray(env, np.int64))
        wrong = ids[(ids < 0) | (ids >= self.num_envs)]
        if len(wrong):
            there = f"there are 0 to {self.num_envs - 1}"
            raise ConfigError(f"no environment {wrong[0]} in the log: {there}")
        if (np.diff(ids) <= 0).any():
            raise ConfigError(f"environments must be in ascending order, not {ids.tolist()}")
        return ids

    def _span_of(self, env: int | Sequence[int] | None, episode: int, span: Steps) -> Steps:
        ids = self._envs(env)
        if len(ids) != 1:
            raise ConfigError(f"episode {episode} has other steps in each environment: name one")
        mine = [e for e in self.episodes if e.env == ids[0]]
        for found in mine:
            if found.episode == episode:
                first, last = max(found.first_step, span.start), min(found.last_step, span.last())
                return Steps(first, last + 1)
        there = f"there are {mine[0].episode} to {mine[-1].episode}" if mine else "there is none"
        raise ConfigError(f"no episode {episode} of environment {ids[0]} in the log: {there}")

    def _gather(
        self, names: Sequence[str], env: int | Sequence[int] | None, span: Steps
    ) -> Gatherer:
        if span.start < 0 or (span.stop is not None and span.stop < span.start):
            raise ConfigError(f"steps from {span.start} to {span.stop}: give 0 <= from <= to")
        components = [name for name in names if name in self.header.layout]
        outcomes = [name for name in names if name in OUTCOMES]
        ids = self._envs(env)
        file: ChunkFile | FilledFile = self._file
        if components and self._simulate and self.header.keyframe_every:
            file = FilledFile(self._file, ids)
        gatherer = Gatherer(file, components, outcomes, ids, span)
        gatherer.run()
        return gatherer

    # -- the rest ----------------------------------------------------------------------------------

    def snapshot(self, env: int, episode: int | None = None, step: int | None = None) -> Snapshot:
        """One environment before a control step: `env.restore(log, ...)` goes on from there.

        Args:
            env: The environment.
            episode: One of its episodes; None counts steps from the start of the recording.
            step: Finished control steps, from the start of the episode or of the recording; None
                is 0.

        Raises:
            ConfigError: If there is no such moment in the log.
            LogError: If the log has no states, or is damaged there.
        """
        from embodichain.recording.snapshots import snapshot

        return snapshot(self, env, episode, step)

    @cached_property
    def episodes(self) -> list[LogEpisode]:
        """Every episode, whole or not, by environment; found in one pass over the log.

        A log with `record.state=none` tells only of those that ended. With `record.every` those
        that were not recorded are there too, with everything but their steps.
        """
        ended = by_episode(self._decoded(EPISODE_TOPIC, decode_ends))
        if self.header.state == "none":
            return of_ended(ended)
        data = self.read(["episodes", "rewards", "terminated", "truncated"])
        found = find_episodes(data, ended)
        return found if self.header.every == 1 else with_unrecorded(found, ended)

    def metrics(self, env: int) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
        """Numbers of a viewed environment: rewards of each term, metrics, sums of the episode.

        Args:
            env: One of `header.view_envs`.

        Returns:
            (S,) sampled control steps, and name to (S,) values.

        Raises:
            ConfigError: If the environment was not viewed.
        """
        if env not in self.header.view_envs:
            there = ", ".join(map(str, self.header.view_envs)) or "none"
            raise ConfigError(f"environment {env} was not viewed; viewed were: {there}")
        return read_metrics(self._file, env)

    def events(self) -> Iterator[LogEvent]:
        """Yield what the event manager did: terms, environments, what they drew."""
        return self._decoded("/sim/event", LogEvent.decode)

    def writes(self) -> Iterator[WriteRecord]:
        """Yield every write to the simulation outside physics, model fields included."""
        return self._decoded("/sim/write", WriteRecord.decode)

    def raw_messages(self) -> Iterator[tuple[str, int, memoryview]]:
        """Yield topic, log time in ns and bytes of every message, in file order."""
        return self._file.messages()

    def full_messages(self, env: int | None = None) -> Iterator[tuple[str, int, memoryview]]:
        """The same, with the states that lie between keyframes, simulated again.

        Args:
            env: The one environment whose states are needed; those of others are NaN. None is all.

        Raises:
            LogError: If the log does not simulate to what it says, or this is another MuJoCo.
        """
        return FilledFile(self._file, None if env is None else self._envs(env)).messages()

    def _decoded(self, topic: str, decode: Callable[[Any], T]) -> Iterator[T]:
        for found, _, payload in self._file.messages():
            if found == topic:
                try:
                    yield decode(payload)
                except wire.WireError as error:
                    raise LogError(f"{self.path}: a message is damaged: {error}") from error
