"""`Augmented`: a policy that repeats recorded motions where their targets are now.

The idea is MimicGen's (Mandlekar et al., "MimicGen: A Data Generation System for Scalable Robot
Learning using Human Demonstrations", CoRL 2023): a segment of a demonstration (`segments`) is moved
and turned as its target was, since it was recorded. Here a segment begins at the pose to which the
tool was sent last. The offset from there to the moved segment is added in full at its start, and
fades out in its first part. Motions go through the task's own actions, so a collection keeps the
episodes that succeed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from embodichain.lab.gym.expert.arms import ControlledArm, arms_of
from embodichain.recording.demos.segments import (
    Source,
    read_sources,
    read_targets,
    read_tools,
    target_poses,
)
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
    from embodichain.lab.sim.engine.api import F64
    from embodichain.lab.sim.types import EnvObs
    from embodichain.utils.array_types import EnvIds

    Ids = NDArray[np.int64]

__all__ = ["Augmented"]

Count = Annotated[int, Field(ge=1)]
STREAM = "policy"
FADE_SHARE = 0.5
"""Share of a segment in which the offset at its start fades out."""
ALLOWED_LAG_STEPS = 2.0
"""Control steps that the tool may be behind; then the motion waits for it."""
ALLOWED_LAG = (0.02, 0.1)
"""Distance in metres and angle in radians that a tool may be behind at any speed."""
UNLIMITED_SPEED = (1.0, 4.0)
"""Speed in m/s and rad/s that is assumed for a tool whose action has no limits."""
WAIT_TIMEOUT_S = 2.0
"""Seconds that a motion waits for the tool."""
METRES_PER_RADIAN = 0.1
"""Distance in metres that counts as much as 1 rad when starts are compared."""
_POS = slice(0, 3)
_QUAT = slice(3, 7)


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

    def reset(self, env_ids: EnvIds | None) -> None:
        """Begin anew in these environments; (n,) int64, or None for all."""
        if self._player is not None:
            self._player.reset(env_ids)

    @property
    def done(self) -> NDArray[np.bool_]:
        """(N,) whether the motion is over; empty before the first action."""
        if self._player is None:
            return np.zeros(0, np.bool_)
        return self._player.done

    @property
    def failures(self) -> Sequence[str | None]:
        """What failed in each environment; empty before the first action."""
        if self._player is None:
            return ()
        return self._player.failures


class _Motions:
    """E episodes side by side, padded to the longest with their last step.

    Attributes:
        length: (E,) control steps.
        actions: (E, T, A).
        tools: (E, arms, T, 7) poses of the tools.
        targets: (E, k, T, 7) poses of the targets.
        segment_starts: (E, arms, S + 1) first control step of each segment. An arm with fewer than
            S segments has the end of the episode in the remaining places.
        segment_targets: (E, arms, S) target of each segment.
        segment_follows: (E, arms, S) whether the target moves meanwhile.
    """

    def __init__(self, sources: Sequence[Source]) -> None:
        self.length = np.array([len(source.actions) for source in sources])
        longest = int(self.length.max())
        self.actions = np.array([_padded(source.actions, longest, axis=0) for source in sources])
        self.tools = np.array([_padded(source.tools, longest, axis=1) for source in sources])
        self.targets = np.array([_padded(source.targets, longest, axis=1) for source in sources])
        num_episodes = len(sources)
        num_arms = self.tools.shape[1]
        num_segments = max(len(segments) for source in sources for segments in source.segments)
        self.segment_starts: Ids = np.empty((num_episodes, num_arms, num_segments + 1), np.int64)
        self.segment_starts[:] = self.length[:, None, None]
        self.segment_targets: Ids = np.zeros((num_episodes, num_arms, num_segments), np.int64)
        self.segment_follows = np.zeros((num_episodes, num_arms, num_segments), np.bool_)
        for episode, source in enumerate(sources):
            for arm, segments in enumerate(source.segments):
                for index, segment in enumerate(segments):
                    self.segment_starts[episode, arm, index] = segment.start
                    self.segment_targets[episode, arm, index] = segment.target
                    self.segment_follows[episode, arm, index] = segment.follows


def _padded(values: F64, length: int, axis: int) -> F64:
    """Repeat the last values along an axis, so that it has this length."""
    widths = [(0, 0)] * values.ndim
    widths[axis] = (0, length - values.shape[axis])
    return np.pad(values, widths, mode="edge")


class _Progress:
    """Which motion each environment plays, and how far it is.

    Attributes:
        is_new: (N,) whether a motion is yet to be drawn.
        motion: (N,) index of the motion.
        clock: (N,) control step of the motion.
        late_steps: (N,) control steps for which the clock has stood still.
        segment: (arms, N) index of the segment, or -1.
        sent: (arms, N, 7) poses to which the tools were sent last.
        target_motion: (arms, N, 7) how the target has moved since it was recorded: a shift after
            a turn about the origin.
        offset: (arms, N, 6) shift and rotation vector from the moved segment to `sent` at its
            start.
    """

    def __init__(self, num_arms: int, num_envs: int) -> None:
        self.is_new = np.ones(num_envs, np.bool_)
        self.motion: Ids = np.zeros(num_envs, np.int64)
        self.clock: Ids = np.zeros(num_envs, np.int64)
        self.late_steps: Ids = np.zeros(num_envs, np.int64)
        self.segment: Ids = np.zeros((num_arms, num_envs), np.int64)
        self.sent: F64 = np.zeros((num_arms, num_envs, 7))
        self.target_motion: F64 = np.zeros((num_arms, num_envs, 7))
        self.offset: F64 = np.zeros((num_arms, num_envs, 6))

    def begin(self, env_ids: Ids, motion: Ids, tools: F64) -> None:
        """Begin motions in some environments, whose tools have these poses (arms, N, 7)."""
        self.is_new[env_ids] = False
        self.motion[env_ids] = motion
        self.clock[env_ids] = 0
        self.late_steps[env_ids] = 0
        self.segment[:, env_ids] = -1
        self.sent[:, env_ids] = tools[:, env_ids]


class _Player:
    """The motions under way in the environments of `env`.

    Attributes:
        env: The environment.
        done: (N,) whether the motion is over.
        failures: What failed in each environment.
    """

    def __init__(self, env: BaseEnv, path: str, most: int, nearest: int) -> None:
        self.env = env
        self._arms: list[ControlledArm] = [arm for _, arm in arms_of(env)]
        if not self._arms:
            raise ConfigError("augmentation needs a task with an action that moves a tool")
        self._target_names, self._target_poses = target_poses(env)
        target_names, sources = read_sources(path, most)
        self._check_task(path, target_names, sources[0])
        self._motions = _Motions(sources)
        self._nearest = min(nearest, len(sources))
        speeds = np.array([arm.term.tool_speeds for arm in self._arms])
        speeds = np.minimum(speeds, UNLIMITED_SPEED)
        # (arms, 2) distance and angle
        self._allowed_lag: F64 = np.maximum(ALLOWED_LAG_STEPS * speeds * env.step_dt, ALLOWED_LAG)
        self._progress = _Progress(len(self._arms), env.num_envs)
        self.done = np.zeros(env.num_envs, np.bool_)
        self.failures: list[str | None] = [None] * env.num_envs

    def _check_task(self, path: str, target_names: Sequence[str], source: Source) -> None:
        """Raise if a demonstration is of a task with other targets, arms or actions."""
        width = source.actions.shape[1]
        if (
            target_names != self._target_names
            or len(source.tools) != len(self._arms)
            or width != sum(self.env.single_action_space.shape or ())
        ):
            raise ConfigError(
                f"{path} is of another task: its entities are {', '.join(target_names)}, "
                f"here {', '.join(self._target_names)}; {width} actions"
            )

    def reset(self, env_ids: EnvIds | None) -> None:
        """Begin again in these environments, at the next action."""
        ids = np.arange(self.env.num_envs) if env_ids is None else np.asarray(env_ids)
        self._progress.is_new[ids] = True
        self.done[ids] = False
        for env_id in ids.tolist():
            self.failures[env_id] = None

    def act(self) -> F64:
        """(N, A) the next actions."""
        progress = self._progress
        tools = read_tools(self._arms)
        targets = read_targets(self._target_names, self._target_poses)
        new_envs = np.flatnonzero(progress.is_new)
        self._advance(tools)
        if len(new_envs):
            motion = self._draw_motions(new_envs, targets)
            progress.begin(new_envs, motion, tools)
        env_ids = np.arange(self.env.num_envs)
        # The numbers of an action that move no tool, such as a gripper's, are the recorded ones.
        action: F64 = self._motions.actions[progress.motion, progress.clock].copy()
        for index, arm in enumerate(self._arms):
            self._enter_segments(index, targets)
            next_step = np.minimum(progress.clock + 1, self._last_step)
            pose = self._pose_at(index, next_step)
            progress.sent[index] = pose
            pos = np.ascontiguousarray(pose[:, _POS])
            quat = np.ascontiguousarray(pose[:, _QUAT])
            solver = arm.term.solver
            solved_quat = None if arm.term.orientation == "free" else quat
            qpos, _ = solver.inverse(
                arm.asset.read_qpos(), pos, solved_quat, env_ids, restarts=False
            )
            action[:, arm.columns] = arm.term.action_towards(pos, quat, qpos[:, solver.moving])
        return action

    @property
    def _last_step(self) -> Ids:
        """(N,) last control step of each motion."""
        return self._motions.length[self._progress.motion] - 1

    def _draw_motions(self, env_ids: Ids, targets: F64) -> Ids:
        """(n,) motions for environments whose episode begins: of those with a similar start."""
        used = np.unique(self._motions.segment_targets)
        recorded = self._motions.targets[:, used, 0]  # (E, used, 7)
        current = targets[:, env_ids][used].swapaxes(0, 1)[:, None]  # (n, 1, used, 7)
        distance = np.linalg.norm((current - recorded)[..., _POS], axis=-1)
        # A quaternion and its negative are the same rotation.
        cosine = np.abs((current[..., _QUAT] * recorded[..., _QUAT]).sum(-1))
        distance += METRES_PER_RADIAN * 2.0 * np.arccos(np.minimum(cosine, 1.0))
        nearest = np.argsort(distance.sum(axis=-1), axis=1, kind="stable")
        draws = self.env.streams.uniform(STREAM, (), 0.0, float(self._nearest), env_ids)
        rank = np.minimum(draws.astype(np.int64), self._nearest - 1)
        return nearest[np.arange(len(env_ids)), rank]

    def _advance(self, tools: F64) -> None:
        """Move the clocks on where the tools have followed."""
        progress = self._progress
        is_behind = self._is_behind(tools)  # (arms, N)
        is_late = is_behind.any(axis=0) & ~progress.is_new
        progress.late_steps = np.where(is_late, progress.late_steps + 1, 0)
        is_over = progress.clock >= self._last_step
        progress.clock += ~is_late & ~is_over
        self.done = is_over & ~progress.is_new
        timed_out = progress.late_steps > WAIT_TIMEOUT_S / self.env.step_dt
        for env_id in np.flatnonzero(timed_out).tolist():
            arm = int(is_behind[:, env_id].argmax())
            segment = int(progress.segment[arm, env_id])
            target = self._motions.segment_targets[progress.motion[env_id], arm, segment]
            name = self._target_names[target]
            self.failures[env_id] = f"segment {segment + 1}, at {name}: the tool did not follow"
            self.done[env_id] = True

    def _is_behind(self, tools: F64) -> NDArray[np.bool_]:
        """(arms, N) whether a tool is farther from where it was sent than allowed."""
        sent = self._progress.sent
        shift = sent[..., _POS] - tools[..., _POS]
        is_behind: NDArray[np.bool_] = (shift * shift).sum(axis=-1) > (
            self._allowed_lag[:, None, 0] ** 2
        )
        for index, arm in enumerate(self._arms):
            if arm.term.orientation == "any":
                turn = quat_multiply(sent[index][:, _QUAT], quat_conjugate(tools[index][:, _QUAT]))
                angle = quat_to_rotvec(turn)
                is_behind[index] |= (angle * angle).sum(axis=-1) > self._allowed_lag[index, 1] ** 2
        return is_behind

    def _enter_segments(self, arm: int, targets: F64) -> None:
        """Begin the next segment of an arm where the clock has come to it."""
        progress = self._progress
        motions = self._motions
        starts = motions.segment_starts[progress.motion, arm]
        segment = (progress.clock[:, None] >= starts).sum(axis=1) - 1
        segment = np.minimum(segment, motions.segment_targets.shape[2] - 1)
        begins = segment != progress.segment[arm]
        progress.segment[arm] = segment
        follows = motions.segment_follows[progress.motion, arm, segment]
        measured = np.flatnonzero(begins | follows)
        if measured.size:
            self._measure_target_motion(arm, measured, targets)
        entering = np.flatnonzero(begins)
        if not entering.size:
            return
        progress.offset[arm, entering] = 0.0
        pose = self._pose_at(arm, progress.clock)[entering]
        sent = progress.sent[arm, entering]
        shift = sent[:, _POS] - pose[:, _POS]
        turn = quat_multiply(sent[:, _QUAT], quat_conjugate(pose[:, _QUAT]))
        progress.offset[arm, entering] = np.concatenate([shift, quat_to_rotvec(turn)], axis=1)

    def _measure_target_motion(self, arm: int, env_ids: Ids, targets: F64) -> None:
        """Measure how the targets of an arm have moved since they were recorded, at this clock."""
        progress = self._progress
        motion = progress.motion[env_ids]
        target = self._motions.segment_targets[motion, arm, progress.segment[arm, env_ids]]
        current = targets[target, env_ids]
        recorded = self._motions.targets[motion, target, progress.clock[env_ids]]
        turn = quat_multiply(current[:, _QUAT], quat_conjugate(recorded[:, _QUAT]))
        recorded_pos = np.ascontiguousarray(recorded[:, _POS])
        shift = current[:, _POS] - quat_rotate(turn, recorded_pos)
        progress.target_motion[arm, env_ids] = np.concatenate([shift, turn], axis=1)

    def _pose_at(self, arm: int, step: Ids) -> F64:
        """(N, 7) pose to which a tool is sent at a control step of its motion."""
        progress = self._progress
        motions = self._motions
        motion = progress.motion
        segment = progress.segment[arm]
        recorded = motions.tools[motion, arm, step]
        start = motions.segment_starts[motion, arm, segment]
        stop = motions.segment_starts[motion, arm, segment + 1]
        duration = FADE_SHARE * np.maximum(stop - start, 1)
        share = np.clip((step - start) / duration, 0.0, 1.0)
        # Smoothstep: the offset begins and stops to fade without a jump of the speed.
        remaining = 1.0 - share * share * (3.0 - 2.0 * share)
        offset = remaining[:, None] * progress.offset[arm]
        shift = progress.target_motion[arm][:, _POS]
        turn = np.ascontiguousarray(progress.target_motion[arm][:, _QUAT])
        pos = shift + quat_rotate(turn, np.ascontiguousarray(recorded[:, _POS]))
        quat = quat_multiply(turn, np.ascontiguousarray(recorded[:, _QUAT]))
        quat = quat_multiply(rotvec_to_quat(np.ascontiguousarray(offset[:, 3:])), quat)
        return np.concatenate([pos + offset[:, :3], quat], axis=1)
