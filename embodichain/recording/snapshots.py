"""`snapshot`: one recorded environment between two control steps, for `BaseEnv.restore`.

The row of a step is recorded as physics received it, controls of the step included. What stood
before them is found by simulating the step before once more, and is checked against its hash.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.snapshot import Drawn, Snapshot
from embodichain.lab.sim.engine.base import F64
from embodichain.recording import wire
from embodichain.recording.api import Log
from embodichain.recording.episodes import LogEpisode
from embodichain.recording.events import LogEvent
from embodichain.recording.header import LogError
from embodichain.recording.messages import State, WriteRecord
from embodichain.recording.playback import Playback, Span, span_of
from embodichain.recording.resimulate import Found, Resimulation
from embodichain.utils.errors import ConfigError

__all__ = ["snapshot"]

_TOPICS = ("/sim/write", "/sim/state", "/sim/physics", "/sim/step", "/sim/event")
_CONTROLS = frozenset({"ctrl", "qfrc_applied", "xfrc_applied"})
Message = tuple[str, memoryview]


def snapshot(log: Log, env: int, episode: int | None = None, step: int | None = None) -> Snapshot:
    """One environment before a control step.

    Args:
        log: The log.
        env: The environment.
        episode: One of its episodes; None counts steps from the start of the recording.
        step: Finished control steps, from the start of the episode or of the recording; None is 0.

    Raises:
        ConfigError: If there is no such moment in the log.
        LogError: If the log has no states, or is damaged there.
    """
    log.header.require_states(log.path)
    found, control_step = _moment(log, env, episode, step)
    elapsed = control_step - found.first_step
    origin = f"{log.path}, environment {env}, episode {found.episode}, step {elapsed}"
    row, fields, notes = _state(log, env, control_step)
    drawn = _drawn(log, env, control_step)
    width = len(log.columns["actions"])
    last_action: F64 = np.zeros(width)
    if elapsed:
        before = log.read("actions", env, start=control_step - 1, stop=control_step)["actions"]
        if len(before) != 1:
            raise LogError(f"{log.path} lacks control step {control_step - 1} where its index says")
        last_action = before.reshape(width)
    if found.first_step == log.header.first_step and not _begins(log, env):
        notes.append("the log begins within this episode: its steps before that are not counted")
    layout = dict(log.header.layout)
    counters = elapsed, found.episode, last_action
    return Snapshot(origin, log.model, layout, row, fields, *counters, drawn, tuple(notes))


def _moment(log: Log, env: int, episode: int | None, step: int | None) -> tuple[LogEpisode, int]:
    """The episode that is meant, and the control step that comes next, from the log's start."""
    span_of(log, env, episode)  # complains
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
    first, last = mine[0].first_step, mine[-1].last_step
    at = first if step is None else step
    if not first <= at <= last + 1:
        raise ConfigError(f"no control step {step} in the log: there are {first} to {last + 1}")
    for found in mine:
        if at <= found.last_step:
            return found, at
    if found.terminated or found.truncated:  # it was reset in its last step
        return LogEpisode(env, found.episode + 1, at, at, 0.0, False, False), at
    return found, at


# -- the state -------------------------------------------------------------------------------------


def _state(log: Log, env: int, step: int) -> tuple[F64, dict[str, NDArray[Any]], list[str]]:
    """(nstate,) row before a control step, model fields, and what is not certain."""
    header = log.header
    why = header.unverifiable
    if header.mujoco_version != mujoco.__version__:
        why = f"recorded with MuJoCo {header.mujoco_version}, this is {mujoco.__version__}"
    if not why:
        try:
            return *_simulated(log, env, step), []
        except Found as other:
            why = f"physics is another here ({other.difference})"
    playback = Playback(log, env)
    for _ in playback.steps(Span(step, step)):
        note = f"{why}: controls are those of step {step}, not of the step before"
        return playback.engine.rows[0].copy(), _fields(playback.engine.state_dict()), [note]
    raise LogError(f"{log.path} has no state of control step {step}; {why}")


class _One(Resimulation):
    """Follows one environment, from the step before the one that is wanted."""

    def __init__(self, log: Log, env: int, first: int) -> None:
        wanted, other = np.ones(1, np.bool_), np.zeros(1, np.bool_)
        super().__init__(
            log.header,
            log.model,
            np.array([env], np.int64),
            lambda step: wanted if step >= first else other,
            num_threads=1,
        )

    def result(self) -> tuple[F64, dict[str, NDArray[Any]]]:
        """The row and the model fields."""
        self.finish()
        return self._engine.rows[0].copy(), _fields(self._engine.state_dict())

    def take(self, topic: str, payload: memoryview) -> None:
        """Follow a message."""
        handlers = {
            "/sim/write": self.on_write,
            "/sim/state": self.on_state,
            "/sim/physics": self.on_call,
            "/sim/step": self.on_step,
        }
        if topic in handlers:
            handlers[topic](payload)


def _fields(state: dict[str, Any]) -> dict[str, NDArray[Any]]:
    return {name: np.array(values[0]).reshape(-1) for name, values in state["model"].items()}


def _simulated(log: Log, env: int, step: int) -> tuple[F64, dict[str, NDArray[Any]]]:
    one = _One(log, env, step - 1)
    held: list[Message] = []  # of the wanted step
    try:
        for topic, _, payload in log.raw_messages():
            if topic not in _TOPICS:
                continue
            if not held and _step_of(payload) < step:
                one.take(topic, payload)
            elif topic == "/sim/step":
                break
            else:
                held.append((topic, payload))
        for message in held[: _before_action(log, held, step)]:
            one.take(*message)
    except (wire.WireError, IndexError, KeyError, ValueError) as error:
        raise LogError(f"{log.path}: a message is damaged: {error}") from error
    return one.result()


def _step_of(payload: memoryview) -> int:
    value = wire.parse(payload).get(1, [0])[-1]
    if not isinstance(value, int):
        raise wire.WireError("a step number is none")
    return value


def _before_action(log: Log, held: Sequence[Message], step: int) -> int:
    """How many messages of a step come before its action is written.

    Normally none. A reset that was asked for between two steps, as the first always is, ends with
    an event, or with a write to something else than controls.
    """
    own = [
        i for i, (topic, data) in enumerate(held) if topic == "/sim/state" and _is_own(log, data)
    ]
    end = len(held) if not own else own[-1] if step == log.header.first_step else own[0]
    marks = [i for i in range(end) if _precedes_action(*held[i])]
    return marks[-1] + 1 if marks else 0


def _is_own(log: Log, payload: memoryview) -> bool:
    state = State.decode(payload)
    return state.env_ids is None and state.nstep in (0, log.header.substeps)


def _precedes_action(topic: str, payload: memoryview) -> bool:
    if topic != "/sim/write":
        return True
    write = WriteRecord.decode(payload)
    return write.op != "state" or write.field not in _CONTROLS


def _drawn(log: Log, env: int, step: int) -> tuple[Drawn, ...]:
    """What terms drew for an environment since it was reset; of each term the last."""
    found: dict[tuple[str, str], Drawn] = {}
    before: dict[tuple[str, str], Drawn] | None = None
    for topic, _, payload in log.raw_messages():
        if topic not in ("/sim/write", "/sim/event", "/sim/state", "/sim/step"):
            continue
        at = _step_of(payload)
        if at > step or (at == step and topic == "/sim/step"):
            break
        if topic == "/sim/write":
            write = WriteRecord.decode(payload)
            if write.op == "reset" and _reaches(write.env_ids, env):
                found = {}
        elif topic == "/sim/event":
            event = LogEvent.decode(payload)
            if _reaches(event.env_ids, env) and (event.drawn or event.mode == "reset"):
                found[event.mode, event.term] = _row_of(event, env)
        elif at == step and topic == "/sim/state" and _is_own(log, payload):
            before = dict(found)
            if step > log.header.first_step:
                break
    return tuple((found if before is None else before).values())


def _row_of(event: LogEvent, env: int) -> Drawn:
    row = env if event.env_ids is None else int(np.searchsorted(event.env_ids, env))
    return Drawn(
        event.term, event.mode, {name: np.array(v[row]) for name, v in event.drawn.items()}
    )


def _reaches(env_ids: NDArray[np.int64] | None, env: int) -> bool:
    return env_ids is None or env in env_ids


def _begins(log: Log, env: int) -> bool:
    """Whether an environment was reset before the first control step of the log."""
    for write in log.writes():
        if write.step > log.header.first_step:
            break
        if write.op == "reset" and _reaches(write.env_ids, env):
            return True
    return False
