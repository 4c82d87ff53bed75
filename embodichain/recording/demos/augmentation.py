"""`Augmented`: a policy that repeats recorded motions where their targets are now.

The idea is MimicGen's (Mandlekar et al., "MimicGen: A Data Generation System for Scalable Robot
Learning using Human Demonstrations", CoRL 2023): a segment of a demonstration (`segments`) is moved
and turned as its target was, since it was recorded. Here a segment begins where the tool was sent
last; what is missing to the moved segment is added in full at its start, and fades out in its first
part. Motions go through the task's own actions, so a collection keeps what succeeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from embodichain.lab.gym.expert.arms import Arm, arms_of
from embodichain.recording.demos.segments import Source, read_sources, read_tools, target_poses
from embodichain.utils.arrays import tensor_of
from embodichain.utils.errors import ConfigError
from embodichain.utils.math import (
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_to_rotvec,
    rotvec_to_quat,
)

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.expert.targets import TargetPoses
    from embodichain.lab.sim.engine.api import F64, EnvIndex
    from embodichain.lab.sim.types import EnvObs

    Rows = NDArray[np.int64]

__all__ = ["Augmented"]

Count = Annotated[int, Field(ge=1)]
STREAM = "policy"
_FADES = 0.5
"""Share of a segment in which what was missing at its start fades out."""
_LAG = 2.0
"""Control steps that the tool may be behind; then the motion waits for it."""
_SLOWEST = 0.02, 0.1
"""M and rad that a tool may always be behind."""
_FASTEST = 1.0, 4.0
"""M/s and rad/s of a tool whose action has no limits."""
_PATIENCE = 2.0
"""Seconds that a motion waits for the tool."""
_RADIAN = 0.1
"""M that count as much as 1 rad when starts are compared."""


class Augmented:
    """Repeats motions of successful episodes; each start draws one of those most like it.

    Args:
        demonstrations: A collection, a log or the folder of a run of the same task.
        most: Episodes that are read at most, the first ones.
        nearest: Number of episodes with the most similar start from which one is drawn.
    """

    def __init__(self, demonstrations: str, most: Count = 20, nearest: Count = 3) -> None:
        self._path = demonstrations
        self._most = most
        self._nearest = nearest
        self._player: _Player | None = None

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        """Return (N, A) float32 actions.

        Raises:
            ConfigError: At the first call, if there is no successful episode, or it is of another
                task.
        """
        if self._player is None or self._player.env is not env:
            self._player = _Player(env, self._path, self._most, self._nearest)
        return tensor_of(self._player.act().astype(np.float32))

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin anew in these environments; (n,) int64, or None for all."""
        if self._player is not None:
            self._player.reset(env_ids)

    @property
    def done(self) -> NDArray[np.bool_]:
        """(N,) whether the motion is over; empty before the first action."""
        return np.zeros(0, np.bool_) if self._player is None else self._player.done

    @property
    def failures(self) -> Sequence[str | None]:
        """What failed in each environment; empty before the first action."""
        return () if self._player is None else self._player.failures


class _Motions:
    """Episodes side by side, padded to the longest with their last step.

    Attributes:
        length: (E,) control steps.
        actions: (E, T, A).
        tools: (E, arms, T, 7).
        targets: (E, k, T, 7).
        starts: (E, arms, S + 1) where each segment begins; the end of an episode for all others.
        of: (E, arms, S) target of each segment.
        follows: (E, arms, S) whether it moves meanwhile.
    """

    def __init__(self, sources: Sequence[Source]) -> None:
        self.length = np.array([len(source.actions) for source in sources])
        longest = int(self.length.max())

        def padded(values: F64, axis: int) -> F64:
            missing = longest - values.shape[axis]
            widths = [(0, missing if i == axis else 0) for i in range(values.ndim)]
            return np.pad(values, widths, mode="edge")

        self.actions = np.array([padded(source.actions, 0) for source in sources])
        self.tools = np.array([padded(source.tools, 1) for source in sources])
        self.targets = np.array([padded(source.targets, 1) for source in sources])
        most = max(len(segments) for source in sources for segments in source.segments)
        shape = len(sources), self.tools.shape[1], most
        self.starts = np.broadcast_to(self.length[:, None, None], (*shape[:2], most + 1)).copy()
        self.of: Rows = np.zeros(shape, np.int64)
        self.follows = np.zeros(shape, np.bool_)
        for e, source in enumerate(sources):
            for a, segments in enumerate(source.segments):
                for s, segment in enumerate(segments):
                    self.starts[e, a, s] = segment.start
                    self.of[e, a, s] = segment.target
                    self.follows[e, a, s] = segment.follows


class _Player:
    """The motions under way in the environments of `env`.

    Attributes:
        env: The environment.
        done: (N,) whether the motion is over.
        failures: What failed in each environment.
    """

    def __init__(self, env: BaseEnv, path: str, most: int, nearest: int) -> None:
        self.env = env
        count = env.num_envs
        self._arms: list[Arm] = [arm for _, arm in arms_of(env)]
        self._names, poses = target_poses(env)
        if not self._arms:
            raise ConfigError("augmentation needs a task with an action that moves a tool")
        self._poses: TargetPoses = poses
        names, sources = read_sources(path, most)
        width = sources[0].actions.shape[1]
        tools = len(sources[0].tools)
        if names != self._names or tools != len(self._arms) or self._width != width:
            there = f"its entities are {', '.join(names)}, here {', '.join(self._names)}"
            raise ConfigError(f"{path} is of another task: {there}; {width} actions")
        self._motions = _Motions(sources)
        self._nearest = min(nearest, len(sources))
        speeds = [arm.term.tool_speeds for arm in self._arms]
        limits = np.minimum(np.array(speeds), _FASTEST)
        self._behind: F64 = np.maximum(_LAG * limits * env.step_dt, _SLOWEST)  # (arms, 2)
        arms = len(self._arms)
        self._fresh = np.ones(count, np.bool_)
        self._motion: Rows = np.zeros(count, np.int64)
        self._clock: Rows = np.zeros(count, np.int64)
        self._late: Rows = np.zeros(count, np.int64)  # control steps that the clock stood still
        self._segment: Rows = np.zeros((arms, count), np.int64)
        self._sent: F64 = np.zeros((arms, count, 7))
        self._moved: F64 = np.zeros((arms, count, 7))  # of the target since it was recorded
        self._missing: F64 = np.zeros((arms, count, 6))  # at the segment's start
        self.done = np.zeros(count, np.bool_)
        self.failures: list[str | None] = [None] * count

    @property
    def _width(self) -> int:
        return sum(self.env.single_action_space.shape or ())

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin anew in these environments, at the next action."""
        rows = np.arange(self.env.num_envs) if env_ids is None else np.asarray(env_ids)
        self._fresh[rows] = True
        self.done[rows] = False
        for row in rows.tolist():
            self.failures[row] = None

    def act(self) -> F64:
        """(N, A) the next actions."""
        tools = read_tools(self._arms)
        targets = self._targets()
        fresh = np.flatnonzero(self._fresh)
        self._advance(tools)
        if len(fresh):
            self._begin(fresh, tools, targets)
        motions = self._motions
        rows = np.arange(self.env.num_envs)
        action: F64 = motions.actions[self._motion, self._clock].copy()
        for a, arm in enumerate(self._arms):
            self._enter(a, targets)
            self._sent[a] = self._asked(a, np.minimum(self._clock + 1, self._last))
            pos, quat = (np.ascontiguousarray(self._sent[a][:, part]) for part in (_POS, _QUAT))
            solver = arm.term.solver
            free = arm.term.orientation == "free"
            here = arm.asset.read_qpos()
            qpos, _ = solver.inverse(here, pos, None if free else quat, rows, restarts=False)
            action[:, arm.columns] = arm.term.action_towards(pos, quat, qpos[:, solver.moving])
        return action

    @property
    def _last(self) -> Rows:
        return self._motions.length[self._motion] - 1

    def _begin(self, rows: Rows, tools: F64, targets: F64) -> None:
        """Draw a motion for environments whose episode begins."""
        self._fresh[rows] = False
        now = targets[:, rows]
        used = np.unique(self._motions.of)
        then = self._motions.targets[:, used, 0]  # (E, used, 7)
        apart = now[used].swapaxes(0, 1)[:, None] - then  # (n, E, used, 7)
        far = np.linalg.norm(apart[..., _POS], axis=-1)
        cosine = np.abs((now[used].swapaxes(0, 1)[:, None, :, _QUAT] * then[..., _QUAT]).sum(-1))
        far += _RADIAN * 2.0 * np.arccos(np.minimum(cosine, 1.0))
        order = np.argsort(far.sum(axis=-1), axis=1, kind="stable")
        drawn = self.env.streams.uniform(STREAM, (), 0.0, float(self._nearest), rows)
        chosen = np.minimum(drawn.astype(np.int64), self._nearest - 1)
        self._motion[rows] = order[np.arange(len(rows)), chosen]
        self._clock[rows] = 0
        self._late[rows] = 0
        self._segment[:, rows] = -1
        self._sent[:, rows] = tools[:, rows]

    def _targets(self) -> F64:
        """(k, N, 7) poses of the targets."""
        return np.array([np.concatenate(self._poses(name), axis=1) for name in self._names])

    def _advance(self, tools: F64) -> None:
        """Move the clocks on where the tools have followed."""
        behind = self._sent[..., _POS] - tools[..., _POS]
        far = (behind * behind).sum(axis=-1) > self._behind[:, None, 0] ** 2
        for a, arm in enumerate(self._arms):
            if arm.term.orientation == "any":
                turn = quat_multiply(self._sent[a][:, _QUAT], quat_conjugate(tools[a][:, _QUAT]))
                angle = quat_to_rotvec(turn)
                far[a] |= (angle * angle).sum(axis=-1) > self._behind[a, 1] ** 2
        late = far.any(axis=0) & ~self._fresh
        self._late = np.where(late, self._late + 1, 0)
        over = self._clock >= self._last
        self._clock += ~late & ~over
        self.done = over & ~self._fresh
        for row in np.flatnonzero(self._late > _PATIENCE / self.env.step_dt).tolist():
            a = int(far[:, row].argmax())
            segment = int(self._segment[a, row])
            name = self._names[self._motions.of[self._motion[row], a, segment]]
            self.failures[row] = f"segment {segment + 1}, at {name}: the tool did not follow"
            self.done[row] = True

    def _enter(self, a: int, targets: F64) -> None:
        """Begin the next segment of an arm where the clock has come to it."""
        starts = self._motions.starts[self._motion, a]
        segment = (self._clock[:, None] >= starts).sum(axis=1) - 1
        segment = np.minimum(segment, self._motions.of.shape[2] - 1)
        begins = segment != self._segment[a]
        self._segment[a] = segment
        follows = self._motions.follows[self._motion, a, segment]
        if (rows := np.flatnonzero(begins | follows)).size:
            self._follow(a, rows, targets)
        if not (rows := np.flatnonzero(begins)).size:
            return
        self._missing[a, rows] = 0.0
        wanted = self._asked(a, self._clock)[rows]
        sent = self._sent[a, rows]
        left = quat_multiply(sent[:, _QUAT], quat_conjugate(wanted[:, _QUAT]))
        missing = [sent[:, _POS] - wanted[:, _POS], quat_to_rotvec(left)]
        self._missing[a, rows] = np.concatenate(missing, axis=1)

    def _follow(self, a: int, rows: Rows, targets: F64) -> None:
        """Find how the target of an arm has moved since it was recorded, at this clock."""
        motion = self._motion[rows]
        target = self._motions.of[motion, a, self._segment[a, rows]]
        now = targets[target, rows]
        then = self._motions.targets[motion, target, self._clock[rows]]
        turn = quat_multiply(now[:, _QUAT], quat_conjugate(then[:, _QUAT]))
        shift = now[:, _POS] - quat_rotate(turn, np.ascontiguousarray(then[:, _POS]))
        self._moved[a, rows] = np.concatenate([shift, turn], axis=1)

    def _asked(self, a: int, clock: Rows) -> F64:
        """(N, 7) pose of a tool at a time of its motion, in the present segment."""
        motions = self._motions
        motion = self._motion
        segment = self._segment[a]
        pose = motions.tools[motion, a, clock]
        moved = self._moved[a]
        start, stop = (motions.starts[motion, a, segment + i] for i in (0, 1))
        share = np.clip((clock - start) / (_FADES * np.maximum(stop - start, 1)), 0.0, 1.0)
        left = (1.0 - share * share * (3.0 - 2.0 * share))[:, None] * self._missing[a]
        turn = np.ascontiguousarray(moved[:, _QUAT])
        pos = moved[:, _POS] + quat_rotate(turn, np.ascontiguousarray(pose[:, _POS]))
        quat = quat_multiply(turn, np.ascontiguousarray(pose[:, _QUAT]))
        quat = quat_multiply(rotvec_to_quat(np.ascontiguousarray(left[:, 3:])), quat)
        return np.concatenate([pos + left[:, :3], quat], axis=1)


_POS = slice(0, 3)
_QUAT = slice(3, 7)
