"""The channels for people: poses, joints, looks and numbers of a few environments, and the log.

The thread that steps physics only copies the viewed rows, a few times a simulated second, and
pushes them as plain data; `ViewEncoder` makes messages of them elsewhere. So looking costs the
simulation next to nothing and cannot disturb it: no derived field of the engine is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64, EnvIndex, Write
from embodichain.recording.foxglove.commands import Commands
from embodichain.recording.foxglove.log_lines import ending_text, ids_text
from embodichain.recording.foxglove.places import pitch_of, places
from embodichain.recording.foxglove.scalars import Scalars
from embodichain.recording.foxglove.view_spec import ViewSpec
from embodichain.recording.options import RecordLike
from embodichain.recording.shapes import LOOKS, PLANE_SIZE

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import EventRecord, ObservedEnv, StepRecord

__all__ = ["SEEN", "Push", "Views"]

SEEN = (
    *LOOKS,
    *("geom_sameframe", "body_pos", "body_quat", "body_sameframe", "jnt_pos", "jnt_axis", "qpos0"),
)
"""Model fields that move or colour anything begin so."""


class Push(Protocol):
    """Hands a call of `ViewEncoder` to whoever makes the messages."""

    def __call__(self, method: str, *args: object) -> None:
        """Hand over a name of `PUSHED` and arguments: plain data that nobody writes into later."""


class Views:
    """Decides what is sampled when, on the simulation's thread.

    Args:
        env: The environment.
        options: Which environments, and how often.
        push: Called with what `ViewEncoder` shall do.
        now: Log time in ns.
        rows_known: Whether whoever makes the messages knows the rows of every step. They are not
            pushed then.
    """

    def __init__(
        self,
        env: ObservedEnv,
        options: RecordLike,
        push: Push,
        now: Callable[[], int],
        rows_known: bool = False,
    ) -> None:
        self._ids = np.array(sorted(set(options.view_envs)), np.int64)
        self._is_viewed = np.zeros(env.num_envs, np.bool_)
        self._is_viewed[self._ids] = True
        self._push, self._now = push, now
        self._every = max(1, math.ceil(1.0 / (options.view_hz * float(env.step_dt)) - 1e-9))
        self._reset: set[int] = set()
        self._asked: set[int] = set(self._ids.tolist())
        self._sampled = -1
        self._drawn: list[bytes] | None = None  # commands, as they were shown last
        self._scalars: Scalars | None = None
        self._rewards = getattr(env, "reward_manager", None)  # environments of others may have none
        self._weights: object = None  # that were shown last
        env_ids = self._ids.tolist()
        self._commands = Commands(env, env_ids)
        self.spec = ViewSpec(
            env_ids=tuple(env_ids),
            offsets=tuple((x, y, z) for x, y, z in places(env, env_ids).tolist()),
            ground=pitch_of(env) if len(env_ids) > 1 else PLANE_SIZE,
            markers=self._commands.markers,
            every=self._every if rows_known else 0,
            period_ns=self._every * round(float(env.step_dt) * 1e9),
        )
        """What `ViewEncoder` is built from."""

    def start(self, model_fields: Mapping[str, NDArray[Any]]) -> None:
        """Say that recording begins; take over model fields that are randomized already."""
        self.take_over(model_fields)
        self.say("recording begins")

    def take_over(self, model_fields: Mapping[str, NDArray[Any]]) -> None:
        """Make viewed environments look as these model fields, (N, ...) each, say."""
        for field, values in model_fields.items():
            rows = np.asarray(values[self._ids], np.float64).reshape(len(self._ids), -1)
            self.on_model_write(Write("model", field, self._ids, slice(None), rows))

    def show(self, env_ids: Iterable[int]) -> None:
        """Show the scenes of these environments with the next sample, whatever was shown."""
        self._asked.update(set(map(int, env_ids)) & set(self.spec.env_ids))

    def say(self, message: str, level: str = "INFO") -> None:
        """Write a line to `/log`."""
        self._push("line", self._now(), message, level)

    def on_model_write(self, write: Write) -> None:
        """A model field of viewed environments changed: their looks and links may have."""
        if write.values is None or not write.field.startswith(SEEN):
            return
        seen = self._seen(write.env_ids)
        columns = write.columns
        if seen and not isinstance(columns, slice):
            columns = columns.copy()
        for row, env_id in seen:
            self._push("set_field", env_id, write.field, columns, write.values[row].copy())

    def _seen(self, env_ids: EnvIndex | None) -> list[tuple[int, int]]:
        """Which of these environments (None: all) are viewed: place among them, and id."""
        if env_ids is None:
            return [(i, i) for i in self._ids.tolist()]
        rows = np.flatnonzero(self._is_viewed[env_ids])
        return list(zip(rows.tolist(), env_ids[rows].tolist(), strict=True))

    def on_rows(self, step: int, rows: F64, last: bool = False) -> None:
        """Physics is about to step: sample the viewed rows when they are due, or after a reset.

        Args:
            step: Control step.
            rows: (N, nstate) live rows.
            last: Nothing follows: sample in any case.
        """
        shown = self._reset or self._asked or last
        known = self.spec.every and not self.spec.markers  # and when it is due, everything is
        if not shown and (known or step % self._every):
            return
        if not self.spec.env_ids or step == self._sampled:
            return
        self._sampled = step
        scenes = {**dict.fromkeys(self._reset, False), **dict.fromkeys(self._asked, True)}
        self._reset.clear()
        self._asked.clear()
        commands = self._commands.take()
        if self.spec.every and not last:
            drawn = [values.tobytes() for values in commands]
            if scenes or drawn != self._drawn:  # commands stay for seconds
                self._drawn = drawn
                self._push("show", scenes, *commands)
            return
        self._push("sample", self._now(), rows[self._ids], scenes, *commands)

    def on_reset(self, env_ids: EnvIndex) -> None:
        """Sample viewed environments that were reset, with their scene if it has changed."""
        seen = env_ids[self._is_viewed[env_ids]]
        if len(seen):
            self._reset.update(seen.tolist())
            self.say(f"environments {ids_text(seen)} reset")

    def on_event(self, event: EventRecord) -> None:
        """Write a line for each viewed environment in which a term fired, with what it drew."""
        what = event.term, event.mode, event.env_ids, tuple(event.drawn)
        self._push("event", self._now(), *what, *map(np.array, event.drawn.values()))

    def on_step(self, step: int, record: StepRecord, ended: bool = True) -> None:
        """Write the numbers of viewed environments when due, and a line for what diverged.

        Args:
            step: Control step.
            record: What it returned.
            ended: Whether an episode may have ended in any environment.
        """
        if ended:
            self._say_endings(step, record)
        if not self.spec.env_ids or step % self._every:
            return
        scalars, manager = self.declare(record), self._rewards
        if manager is not None and manager.weights is not self._weights:
            self._weights = manager.weights
            self._push("factors", scalars.factors(manager.weights))
        self._push("numbers", self._now(), scalars.take(record))

    def _say_endings(self, step: int, record: StepRecord) -> None:
        diverged = record.info.get("diverged")
        if diverged is not None and record.terminated.any():  # to diverge is to terminate
            ids = np.flatnonzero(np.asarray(diverged))
            if len(ids):
                self.say(f"environments {ids_text(ids)} diverged in step {step}", "WARNING")
        over = record.terminated[self._ids] | record.truncated[self._ids]
        for env_id in self._ids[over].tolist():
            self.say(ending_text(record, env_id))

    def declare(self, record: StepRecord) -> Scalars:
        """Find the run's scalars in its first step, and declare their channels."""
        if self._scalars is not None:
            return self._scalars
        self._scalars = Scalars(record, self._ids, self._commands.scalars())
        self._push("scalars", tuple(self._scalars.names))
        return self._scalars

    def close(self, step: int, rows: F64) -> None:
        """Show the last state, and say that recording ends."""
        self.on_rows(step, rows, last=True)
        self.say(f"recording ends after {step} steps")
