"""`Log`: reading a log, including snapshots for `BaseEnv.restore`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.restoring.snapshot import Drawn, Snapshot
from embodichain.lab.sim.engine.api import F64
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import DRAWN, Call, Run
from embodichain.recording.read.episodes import LogEpisode
from embodichain.recording.read.playback import follower_of, span_of
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.recording.read.trajectory import Span, physics_call, runs
from embodichain.utils.array_types import EnvIds
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
        current, control_step = _moment(self, env, episode, step)
        elapsed = control_step - current.first_step
        row, fields = _state(self, env, control_step)
        drawn, reset_at_start = _history(self, env, control_step)
        notes = []
        if current.first_step == self.header.first_step and not reset_at_start:
            notes.append(
                "the log begins within this episode: its steps before that are not counted"
            )
        return Snapshot(
            origin=f"{self.path}, environment {env}, episode {current.episode}, step {elapsed}",
            model=self.model,
            layout=dict(self.header.layout),
            row=row,
            fields=fields,
            elapsed=elapsed,
            episode=current.episode,
            last_action=self._action_before(env, control_step, elapsed),
            drawn=drawn,
            notes=tuple(notes),
        )

    def _action_before(self, env: int, control_step: int, elapsed: int) -> F64:
        """The action of the step before; zeros at the start of an episode."""
        width = len(self.columns["actions"])
        if not elapsed:
            return np.zeros(width)
        previous = control_step - 1
        actions = self.read("actions", env, start=previous, stop=control_step)["actions"]
        if len(actions) != 1:
            raise LogError(f"{self.path} lacks control step {previous} where its index says")
        return actions.reshape(width)


def _moment(
    log: RecordedLog, env: int, episode: int | None, step: int | None
) -> tuple[LogEpisode, int]:
    """The selected episode, and the next control step, counted from the log's start."""
    span_of(log, env, episode)  # raises if there is none
    episodes = [e for e in log.episodes if e.env == env]
    if not episodes:
        raise ConfigError(f"{log.path} has no control step of environment {env}")
    if episode is not None:
        return _moment_in_episode(next(e for e in episodes if e.episode == episode), step)
    first = episodes[0].first_step
    last = episodes[-1].last_step
    control_step = first if step is None else step
    if not first <= control_step <= last + 1:
        raise ConfigError(f"no control step {step} in the log: there are {first} to {last + 1}")
    for index, current in enumerate(episodes):
        if index and control_step < current.first_step:
            # Between two episodes is the step in which NEXT_STEP resets: the first one is over.
            return episodes[index - 1], control_step
        if control_step <= current.last_step:
            return current, control_step
    final = episodes[-1]
    if not final.terminated and not final.truncated:
        return final, control_step
    # The environment was reset in the last step of the log: the next episode has no step yet.
    following = LogEpisode(
        env=env,
        episode=final.episode + 1,
        first_step=control_step,
        last_step=control_step,
        total_reward=0.0,
        terminated=False,
        truncated=False,
    )
    return following, control_step


def _moment_in_episode(episode: LogEpisode, step: int | None) -> tuple[LogEpisode, int]:
    """The same for a number of finished steps of an episode."""
    elapsed = 0 if step is None else step
    # After the last step of an episode that is over, its environment has been reset.
    is_over = episode.terminated or episode.truncated
    largest = episode.steps - 1 if is_over else episode.steps
    if not 0 <= elapsed <= largest:
        raise ConfigError(
            f"no step {step} in episode {episode.episode} of environment {episode.env}: "
            f"there are 0 to {largest}"
        )
    return episode, episode.first_step + elapsed


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
    env_fields = {name: np.array(values[0]).reshape(-1) for name, values in fields.items()}
    return follower.rows[0].copy(), env_fields


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
            calls = run.calls
            if number == step:
                calls = calls[: _num_calls_before_action(log, run)]
            for call in calls:
                yield number, call, t


def _num_calls_before_action(log: RecordedLog, run: Run) -> int:
    """The number of calls of a step before its action is written.

    Usually 0. The calls of a reset between two steps, as the first reset always is, end with an
    event, or with a write to something other than controls.
    """
    end = physics_call(log.reader, run) if run.steps else len(run.calls)
    for index in reversed(range(end)):
        if _precedes_action(run.calls[index]):
            return index + 1
    return 0


def _precedes_action(call: Call) -> bool:
    kind = call.kind
    return kind.kind != "write" or kind.mode != "state" or kind.name not in _CONTROLS


def _history(log: RecordedLog, env: int, step: int) -> tuple[tuple[Drawn, ...], bool]:
    """The last draw of each term for an environment since its reset.

    Also returns whether the environment was reset before the first control step of the log.
    """
    draws: dict[tuple[str, str], Drawn] = {}  # by mode and term
    reset_at_start = False
    first = log.header.first_step
    for number, call, t in _calls_before(log, step, first):
        if isinstance(call, Run):
            continue
        ids = call.arrays["env_ids"][t] if "env_ids" in call.arrays else None
        if ids is not None and env not in ids:
            continue
        kind = call.kind
        if kind.kind == "write" and kind.mode == "reset":
            draws = {}
            reset_at_start = reset_at_start or number <= first
        elif kind.kind == "event":
            drew_values = any(name.startswith(DRAWN) for name in call.arrays)
            if drew_values or kind.mode == "reset":
                draws[kind.mode, kind.name] = _drawn(call, t, ids, env)
    return tuple(draws.values()), reset_at_start


def _drawn(call: Call, t: int, ids: EnvIds | None, env: int) -> Drawn:
    row = env if ids is None else int(np.searchsorted(ids, env))
    values = {}
    for name, drawn in call.arrays.items():
        if name.startswith(DRAWN):
            if drawn.ndim < 2 or row >= drawn.shape[1]:
                raise LogError(f"{call.kind.name}: its draws are not of every environment")
            values[name.removeprefix(DRAWN)] = np.array(drawn[t, row])
    return Drawn(call.kind.name, call.kind.mode, values)
