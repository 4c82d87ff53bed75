"""`Log`: reading a log, including snapshots for `BaseEnv.restore`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.restoring.snapshot import Drawn, Snapshot
from embodichain.lab.sim.engine.api import F64, EnvIndex
from embodichain.recording.format.block import DRAWN, Call, Run
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.episodes import LogEpisode
from embodichain.recording.read.playback import follower_of, span_of
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.recording.read.trajectory import Span, own_physics, runs
from embodichain.utils.errors import ConfigError

__all__ = ["Log"]

_CONTROLS = frozenset({"ctrl", "qfrc_applied", "xfrc_applied"})


class Log(RecordedLog):
    """An open log.

    Attributes:
        path: The file.
        reader: The file's chunks, channels and messages.
        header: Metadata: task, seed, num_envs, time steps, layout of states, options.
    """

    def snapshot(self, env: int, episode: int | None = None, step: int | None = None) -> Snapshot:
        """The state of one environment before a control step, for `env.restore(log, ...)`.

        Args:
            env: The environment.
            episode: One of its episodes; None counts steps from the start of the recording.
            step: Number of finished control steps since the start of the episode or recording;
                None is 0.

        Raises:
            ConfigError: If the log does not contain this step.
            LogError: If the log has no states, or is damaged there.
        """
        self.header.require_states(self.path)
        found, control_step = _moment(self, env, episode, step)
        elapsed = control_step - found.first_step
        origin = f"{self.path}, environment {env}, episode {found.episode}, step {elapsed}"
        row, fields = _state(self, env, control_step)
        drawn, begins = _history(self, env, control_step)
        width = len(self.columns["actions"])
        last_action: F64 = np.zeros(width)
        if elapsed:
            before = self.read("actions", env, start=control_step - 1, stop=control_step)["actions"]
            if len(before) != 1:
                raise LogError(
                    f"{self.path} lacks control step {control_step - 1} where its index says"
                )
            last_action = before.reshape(width)
        notes = []
        if found.first_step == self.header.first_step and not begins:
            notes.append(
                "the log begins within this episode: its steps before that are not counted"
            )
        layout = dict(self.header.layout)
        counters = elapsed, found.episode, last_action
        return Snapshot(origin, self.model, layout, row, fields, *counters, drawn, tuple(notes))


def _moment(
    log: RecordedLog, env: int, episode: int | None, step: int | None
) -> tuple[LogEpisode, int]:
    """The selected episode, and the next control step, counted from the log's start."""
    span_of(log, env, episode)  # raises if there is none
    mine = [e for e in log.episodes if e.env == env]
    if not mine:
        raise ConfigError(f"{log.path} has no control step of environment {env}")
    if episode is not None:
        found = next(e for e in mine if e.episode == episode)
        done = found.terminated or found.truncated
        most = found.steps - 1 if done else found.steps
        at = found.first_step + (step or 0)
        if not found.first_step <= at <= found.first_step + most:
            raise ConfigError(
                f"no step {step} in episode {episode} of environment {env}: there are 0 to {most}"
            )
        return found, at
    first = mine[0].first_step
    last = mine[-1].last_step
    at = first if step is None else step
    if not first <= at <= last + 1:
        raise ConfigError(f"no control step {step} in the log: there are {first} to {last + 1}")
    for found in mine:
        if at <= found.last_step:
            return found, at
    if found.terminated or found.truncated:  # it was reset in its last step
        return LogEpisode(env, found.episode + 1, at, at, 0.0, False, False), at
    return found, at


def _state(log: RecordedLog, env: int, step: int) -> tuple[F64, dict[str, NDArray[Any]]]:
    """(nstate,) row before a control step, and the model fields."""
    follower = follower_of(log, env)
    for number, call, t in _calls_before(log, step, max(step - 1, log.header.first_step)):
        if isinstance(call, Run):
            follower.begin(call)
        else:
            follower.apply(number, call, t)
    if follower.next_step != step:
        raise LogError(f"{log.path} has no state of control step {step}")
    fields = follower.engine.state_dict()["model"]
    own = {name: np.array(values[0]).reshape(-1) for name, values in fields.items()}
    return follower.rows[0].copy(), own


def _calls_before(log: RecordedLog, step: int, first: int) -> Iterator[tuple[int, Call | Run, int]]:
    """Yield the starts and calls before the action of a control step is written.

    Args:
        log: The log.
        step: The control step.
        first: The first step that is needed; earlier ones may be yielded too.
    """
    for run in runs(log.reader, Span(first, step)):
        if run.of_kind("start"):
            yield run.first, run, 0
            continue
        for t in range(run.count):
            number = run.first + t
            if number > step:
                return
            count = len(run.calls) if number < step else _before_action(log, run)
            for call in run.calls[:count]:
                yield number, call, t


def _before_action(log: RecordedLog, run: Run) -> int:
    """The number of calls of a step before its action is written.

    Usually 0. The calls of a reset between two steps, as the first reset always is, end with an
    event, or with a write to something other than controls.
    """
    end = own_physics(log.reader, run) if run.steps else len(run.calls)
    marks = [i for i in range(end) if _precedes_action(run.calls[i])]
    return marks[-1] + 1 if marks else 0


def _precedes_action(call: Call) -> bool:
    kind = call.kind
    return kind.kind != "write" or kind.mode != "state" or kind.name not in _CONTROLS


def _history(log: RecordedLog, env: int, step: int) -> tuple[tuple[Drawn, ...], bool]:
    """The last draw of each term for an environment since its reset.

    Also returns whether the environment was reset before the first control step of the log.
    """
    found: dict[tuple[str, str], Drawn] = {}
    begins = False
    first = log.header.first_step
    for number, call, t in _calls_before(log, step, first):
        if isinstance(call, Run):
            continue
        ids = call.arrays["env_ids"][t] if "env_ids" in call.arrays else None
        if ids is not None and env not in ids:
            continue
        kind = call.kind
        if kind.kind == "write" and kind.mode == "reset":
            found = {}
            begins = begins or number <= first
        elif kind.kind == "event" and (
            len(call.arrays) > (ids is not None) or kind.mode == "reset"
        ):
            found[kind.mode, kind.name] = _drawn(call, t, ids, env)
    return tuple(found.values()), begins


def _drawn(call: Call, t: int, ids: EnvIndex | None, env: int) -> Drawn:
    row = env if ids is None else int(np.searchsorted(ids, env))
    values = {}
    for name, drawn in call.arrays.items():
        if name.startswith(DRAWN):
            if drawn.ndim < 2 or row >= drawn.shape[1]:
                raise LogError(f"{call.kind.name}: what it drew is not of every environment")
            values[name.removeprefix(DRAWN)] = np.array(drawn[t, row])
    return Drawn(call.kind.name, call.kind.mode, values)
