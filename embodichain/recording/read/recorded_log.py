"""`RecordedLog`: metadata, config, model, episodes and arrays of a log, read on demand."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import mujoco
import numpy as np
import yaml
from numpy.typing import NDArray

from embodichain.recording.format.attachments import (
    MODEL,
    VARIED,
    approximate_model,
    exact_model,
    model_to_simulate,
)
from embodichain.recording.format.header import Header
from embodichain.recording.format.log_error import DamageError, LogError
from embodichain.recording.format.messages.columns import Column, state_columns
from embodichain.recording.format.messages.episodes import COUNTED_TOPIC, EPISODE_TOPIC
from embodichain.recording.read.arrays import OUTCOMES, LogArrays, first_step, gather
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.counted import Counting
from embodichain.recording.read.episodes import (
    LogEpisode,
    decode_ends,
    episode_of,
    find_episodes,
)
from embodichain.recording.read.events import (
    LogEvent,
    LogWrite,
    read_events,
    read_metrics,
    read_writes,
)
from embodichain.recording.read.simulation import Simulation
from embodichain.recording.read.trajectory import FollowedRows, Span, outcomes, runs
from embodichain.utils.array_types import EnvIds
from embodichain.utils.env_text import shown
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = ["RecordedLog"]


class RecordedLog:
    """An open log.

    Attributes:
        path: The file.
        reader: The file's chunks, channels and messages.
        header: Metadata: task, seed, num_envs, time steps, layout of states, options.
    """

    def __init__(self, path: str | Path, simulate: bool = False) -> None:
        self.reader = LogReader(path)
        self._simulate = simulate
        self.path = self.reader.path
        try:
            self.header: Header = self.reader.require_header()
            if not self.header.period_ns:
                raise LogError(f"{self.path}: a control step takes {self.header.control_dt} s")
        except LogError:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; arrays that were read stay valid."""
        self.reader.close()

    def part_of(self, env: int) -> tuple[RecordedLog, int]:
        """The log with the messages of an environment, and the environment's number in it."""
        return self, env

    def __enter__(self) -> Self:
        """Return the log."""
        return self

    def __exit__(self, *error: object) -> None:
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
        """Number of environments N."""
        return self.header.num_envs

    @property
    def dt(self) -> float:
        """Length of a control step in seconds."""
        return self.header.control_dt

    @property
    def complete(self) -> bool:
        """Whether the recorder closed the file and no damage was found so far."""
        return self.reader.complete and self.reader.finished

    @property
    def warnings(self) -> list[str]:
        """What was found missing or damaged so far; empty for a complete log."""
        if not self.reader.complete:
            return [f"incomplete: {self.reader.cut}; only what precedes can be read"]
        if self.reader.recovered:
            return [f"recovered from a broken file: {self.reader.recovered}"]
        if not self.reader.finished:
            return ["the recorder did not close this log: its last steps may be missing"]
        if self.reader.part_note:
            return [self.reader.part_note]
        return []

    @cached_property
    def versions(self) -> dict[str, str]:
        """Versions of the software that determines a run's results."""
        try:
            versions: dict[str, str] = json.loads(self.attachment("versions.json"))
        except ValueError as error:
            raise LogError(f"{self.path}: versions.json is damaged: {error}") from error
        return versions

    @property
    def config_yaml(self) -> str:
        """The resolved config, as it was written.

        Raises:
            LogError: If it is missing or damaged.
        """
        try:
            return self.attachment("config.yaml").decode()
        except UnicodeDecodeError as error:
            raise LogError(f"{self.path}: config.yaml is damaged: {error}") from error

    @cached_property
    def written_config(self) -> dict[str, Any]:
        """The resolved config as a tree, with interpolations for text of the environment."""
        try:
            tree = yaml.safe_load(self.config_yaml)
        except yaml.YAMLError as error:
            raise LogError(f"{self.path}: config.yaml is damaged: {error}") from error
        return tree or {}

    @cached_property
    def varied(self) -> frozenset[str]:
        """Key paths of the config that variations have set.

        Raises:
            LogError: If the attachment that lists them is damaged.
        """
        if VARIED not in self.attachments:
            return frozenset()
        try:
            paths = yaml.safe_load(self.attachment(VARIED).decode())
        except (UnicodeDecodeError, yaml.YAMLError) as error:
            raise LogError(f"{self.path}: {VARIED} is damaged: {error}") from error
        if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
            raise LogError(f"{self.path}: {VARIED} is damaged: it is not a list of key paths")
        return frozenset(paths)

    @cached_property
    def config(self) -> dict[str, Any]:
        """The resolved config as a tree, with ``<env NAME>`` for text of the environment."""
        tree: dict[str, Any] = shown(self.written_config)
        return tree

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The recorded model: exact with the same MuJoCo, else compiled from the scene's XML.

        Raises:
            LogError: If it is missing, or this version of MuJoCo cannot read it.
        """
        is_same_mujoco = self.header.mujoco_version == mujoco.__version__
        data = self.attachment(MODEL if is_same_mujoco else "scene.mjz")
        try:
            if is_same_mujoco:
                return exact_model(self.header, data)
            return approximate_model(self.header, data)
        except LogError as error:
            raise LogError(f"{self.path}: {error}") from error

    @property
    def attachments(self) -> list[str]:
        """Names of the attachments."""
        return self.reader.attachments

    def attachment(self, name: str) -> bytes:
        """Content of an attachment.

        Raises:
            LogError: If there is no attachment of this name, or it is damaged.
        """
        return self.reader.attachment(name)

    # -- arrays ------------------------------------------------------------------------------------

    @cached_property
    def columns(self) -> dict[str, list[Column]]:
        """Every field that `read` accepts, with the name and unit of each column."""
        outcome_columns = {}
        for name in ("rewards", "terminated", "truncated", "episodes"):
            outcome_columns[name] = [Column(name, "")]
        if self.header.state == "none":
            return outcome_columns
        columns = state_columns(self.model, self.header.layout)
        columns |= outcome_columns
        columns["actions"] = self._action_columns()
        return columns

    def _action_columns(self) -> list[Column]:
        """Columns of an action, without unit; their indices if the log has no names for them."""
        width = self._action_width()
        named_columns = self.header.action
        if len(named_columns) == width:
            return [Column(column["name"], "") for column in named_columns]
        return [Column(str(i), "") for i in range(width)]

    def _action_width(self) -> int:
        """Number of columns of an action; 0 if the log has no steps."""
        for run in runs(self.reader, is_read=outcomes):
            if run.steps:
                return int(run.calls[-1].arrays["action"].shape[-1])
        return 0

    @property
    def _default_fields(self) -> list[str]:
        """Fields that are read by default: all but hidden inputs of physics."""
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
        """Arrays of some fields, environments and steps; reads only the chunks that contain them.

        A step's state is the input of its physics: after all writes of the step, including ctrl.
        Its reward is that of the following state, one control step later. Only complete steps are
        read.

        Args:
            fields: Components of the state (`qpos`, `qvel`, `ctrl`, `mocap_pos`, ...), `actions`,
                `rewards`, `terminated`, `truncated`, `episodes`; None reads all but `time`,
                `eq_active`, applied forces and the solver's warm start.
            env: An environment, or several in ascending order; None reads all.
            episode: Only this episode; `env` must be a single environment.
            start: First control step.
            stop: End of the control steps, exclusive; None is the end of the log.

        Raises:
            ConfigError: If a field, environment or episode does not exist.
            LogError: If the log has no states, or is inconsistent.
        """
        self.header.require_states(self.path)
        names = self._fields(fields)
        env_ids = self._envs(env)
        if start < 0 or (stop is not None and stop < start):
            raise ConfigError(f"steps from {start} to {stop}: give 0 <= from <= to")
        span = Span(start, None if stop is None else stop - 1)
        if episode is not None:
            span = self._span_of(env_ids, episode, span)
        simulates = self._simulate and self.header.keyframe_every > 0
        if simulates and any(name in self.header.layout for name in names):
            rows: FollowedRows = Simulation(self.reader, self.model_to_simulate, env_ids)
        else:
            rows = FollowedRows(self.reader, env_ids)
        return gather(self.reader, rows, span, names, self.columns)

    @property
    def model_to_simulate(self) -> mujoco.MjModel:
        """The model, if states between keyframes can be simulated bit for bit on this machine.

        Raises:
            LogError: If they cannot.
        """
        try:
            return model_to_simulate(self.header, self.attachment)
        except LogError as error:
            raise LogError(f"{self.path}: states between keyframes {error}") from error

    def parts(
        self,
        fields: str | Iterable[str] | None = None,
        env: int | Sequence[int] | None = None,
        episode: int | None = None,
        start: int = 0,
        stop: int | None = None,
        steps: int = 1000,
    ) -> Iterator[LogArrays]:
        """Like `read`, but `steps` control steps at a time, for data larger than memory."""
        if steps < 1:
            raise ConfigError(f"parts of {steps} control steps: give 1 or more")
        names = self._fields(fields)
        if episode is not None:
            span = Span(start, None if stop is None else stop - 1)
            span = self._span_of(self._envs(env), episode, span)
            start = span.first
            stop = None if span.last is None else span.last + 1
        last = None if stop is None else stop - 1
        next_step: int | None = start
        while next_step is not None and (stop is None or next_step < stop):
            end = next_step + steps
            if stop is not None:
                end = min(end, stop)
            part = self.read(names, env, start=next_step, stop=end)
            if len(part):
                yield part
                next_step = end
            else:
                # After a gap, continue at the next step that was recorded.
                next_step = first_step(self.reader, Span(end, last))

    def _fields(self, fields: str | Iterable[str] | None) -> list[str]:
        if fields is None:
            return self._default_fields
        names = [fields] if isinstance(fields, str) else list(fields)
        for name in names:
            if name not in self.columns:
                hint = did_you_mean(name, self.columns)
                raise ConfigError(f"no field {name!r}.{hint} Fields: {', '.join(self.columns)}")
        # Components of the state first, as in `columns`.
        return sorted(dict.fromkeys(names), key=lambda name: name in OUTCOMES)

    def _envs(self, env: int | Sequence[int] | None) -> EnvIds:
        if env is None:
            return np.arange(self.num_envs)
        env_ids = np.atleast_1d(np.asarray(env, np.int64))
        for env_id in env_ids.tolist():
            self.header.check_env(env_id)
        if (np.diff(env_ids) <= 0).any():
            raise ConfigError(f"environments must be in ascending order, not {env_ids.tolist()}")
        return env_ids

    def _span_of(self, env_ids: EnvIds, episode: int, span: Span) -> Span:
        """The steps of a span that belong to an episode."""
        if len(env_ids) != 1:
            raise ConfigError(f"episode {episode} has other steps in each environment: name one")
        steps = episode_of(self.episodes, int(env_ids[0]), episode)
        first = max(steps.first_step, span.first)
        last = steps.last_step
        if span.last is not None:
            last = min(last, span.last)
        return Span(first, last)

    # -- the rest ----------------------------------------------------------------------------------

    @cached_property
    def episodes(self) -> list[LogEpisode]:
        """Every episode, complete or not, by environment; found in one pass over the log.

        With `record.state=none`, only episodes that ended are listed. With `record.every`,
        episodes that were not recorded are listed too, without their steps.
        """
        counting = Counting(self.header)
        data = None
        ended = self._ended(counting)
        if self.header.state != "none":
            data = self.read(["episodes", "rewards", "terminated", "truncated"])
        return counting.marked(find_episodes(ended, data, self.header.every))

    def metrics(self, env: int) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
        """Values of a viewed environment: rewards of each term, metrics, sums over the episode.

        Args:
            env: One of `header.view_envs`.

        Returns:
            (S,) sampled control steps, and a dict from name to (S,) values.

        Raises:
            ConfigError: If the environment was not viewed.
        """
        if env not in self.header.view_envs:
            viewed = ", ".join(map(str, self.header.view_envs)) or "none"
            raise ConfigError(f"environment {env} was not viewed; viewed were: {viewed}")
        return read_metrics(self.reader, env)

    def events(self) -> Iterator[LogEvent]:
        """Yield the events of the event manager: term, environments and drawn values."""
        return read_events(self.reader)

    def writes(self) -> Iterator[LogWrite]:
        """Yield every write to the simulation outside physics, including model fields."""
        return read_writes(self.reader)

    def raw_messages(self) -> Iterator[tuple[str, int, memoryview]]:
        """Yield topic, log time in ns and bytes of every message, in file order."""
        return self.reader.messages()

    def _ended(self, counting: Counting) -> list[LogEpisode]:
        """Episodes that ended; `counting` receives what the log lists as counted."""
        ended: list[LogEpisode] = []
        for topic, _, payload in self.reader.messages():
            try:
                if topic == EPISODE_TOPIC:
                    ended += decode_ends(payload)
                elif topic == COUNTED_TOPIC:
                    counting.add(payload)
            except DamageError as error:
                raise LogError(f"{self.path}: a message is damaged: {error}") from error
        return ended
