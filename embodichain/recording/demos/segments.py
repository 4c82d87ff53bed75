"""`read_sources`: the tool's motions in successful episodes of a log, split into segments.

A segment is a part of an episode in which an arm acts on one target: an entity, a link of an
articulation, or the pose of a command. Segments end where the gripper has closed or opened and the
tool moves on. The target of a segment is the one that the tool is nearest to at that moment, and in
the last segment the one that it comes nearest to, without those that it holds. If there is no other
target, it is the world.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.expert.arms import ControlledArm, arms_of
from embodichain.lab.gym.expert.targets import WORLD, TargetPoses
from embodichain.recording.demos.collection import is_collection, read_collection
from embodichain.recording.demos.reenactment import Reenactment
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.api import F64

__all__ = [
    "Segment",
    "Source",
    "read_sources",
    "read_targets",
    "read_tools",
    "target_poses",
]

_MOVED_ON = 0.005
"""Distance in metres from where its gripper acted at which a tool has moved on."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of the motion of one arm.

    Attributes:
        start: Its first control step.
        stop: Its last one plus 1.
        target: Index of the target that it acts on.
        follows: Whether another arm holds the target, which therefore moves.
    """

    start: int
    stop: int
    target: int
    follows: bool = False


@dataclass(frozen=True, slots=True)
class Source:
    """A successful episode of T control steps, with k targets.

    Attributes:
        actions: (T, A).
        tools: (arms, T, 7) pose of each tool before the steps, x, y, z, qw, qx, qy, qz.
        targets: (k, T, 7) poses of the targets.
        segments: For each arm, in order, without gaps.
    """

    actions: F64
    tools: F64
    targets: F64
    segments: tuple[tuple[Segment, ...], ...]


def target_poses(env: BaseEnv) -> tuple[list[str], TargetPoses]:
    """The names of all possible targets in an environment, the first the world; their poses."""
    poses = TargetPoses(env)
    candidates = [WORLD, *env.sim.rigid_objects]
    for uid, articulation in env.sim.articulations.items():
        candidates += [f"{uid}/{link}" for link in articulation.link_names]
    candidates += env.command_manager.terms
    names = []
    for name in candidates:
        try:
            poses.add(name, "")
        except ConfigError:  # the command is not a pose
            continue
        names.append(name)
    return names, poses


def read_targets(names: Sequence[str], poses: TargetPoses) -> F64:
    """(k, N, 7) poses of the targets."""
    return np.array([np.concatenate(poses(name), axis=1) for name in names])


def read_tools(arms: Sequence[ControlledArm]) -> F64:
    """(arms, N, 7) poses of the tools."""
    poses = [arm.term.solver.forward(arm.asset.read_qpos()) for arm in arms]
    return np.array([np.concatenate(pos_and_quat, axis=1) for pos_and_quat in poses])


def read_sources(path: str | Path, most: int) -> tuple[list[str], list[Source]]:
    """Read successful episodes, by stepping their task through the recorded actions.

    Args:
        path: A collection, a log, or the folder of a run.
        most: Number of episodes that are read at most, the first ones.

    Returns:
        The names of the targets, and the episodes.

    Raises:
        ConfigError: If there is no successful episode, or the log cannot be reenacted.
    """
    names: list[str] = []
    sources: list[Source] = []
    for selection in _select_episodes(Path(path), most):
        with selection.log as log, Reenactment(log, selection.stream_numbers) as play:
            names, poses = target_poses(play.env)
            arms = [arm for _, arm in arms_of(play.env)]
            sources += _read(play, arms, names, poses, selection.steps)
    if not sources:
        raise ConfigError(f"{path} has no successful episode")
    return names, sources


@dataclass(frozen=True, slots=True)
class _SelectedEpisodes:
    """The episodes of a log that are read.

    Attributes:
        log: The log.
        steps: (environment, episode) to its control steps in the log.
        stream_numbers: As in `Reenactment`.
    """

    log: RecordedLog
    steps: dict[tuple[int, int], range]
    stream_numbers: dict[tuple[int, int], int] | None


def _select_episodes(path: Path, most: int) -> Iterator[_SelectedEpisodes]:
    """Yield the first successful episodes of a log or a collection, log by log."""
    if not (path.is_dir() and is_collection(path)):
        log = RecordedLog(path)
        successes = [episode for episode in log.episodes if episode.success]
        successes.sort(key=lambda episode: episode.last_step)
        log_steps = {
            (e.env, e.episode): range(e.first_step, e.last_step + 1) for e in successes[:most]
        }
        yield _SelectedEpisodes(log, log_steps, stream_numbers=None)
        return
    successes_listed = read_collection(path)[:most]
    all_listed = read_collection(path, failures=True)
    for name in sorted({episode.log for episode in successes_listed}):
        steps = {}
        for episode in successes_listed:
            if episode.log == name:
                stop = episode.first_step + episode.steps
                steps[episode.env, episode.episode] = range(episode.first_step, stop)
        numbers = {(e.env, e.episode): e.attempt for e in all_listed if e.log == name}
        yield _SelectedEpisodes(RecordedLog(path / name), steps, numbers)


class _Sample(NamedTuple):
    """One control step of an environment.

    Attributes:
        action: (A,).
        tools: (arms, 7) poses before the step.
        targets: (k, 7) poses before the step.
    """

    action: F64
    tools: F64
    targets: F64


def _read(
    play: Reenactment,
    arms: Sequence[ControlledArm],
    names: Sequence[str],
    poses: TargetPoses,
    episode_steps: Mapping[tuple[int, int], range],
) -> Iterator[Source]:
    """The selected episodes of a log, in the order in which they end."""
    samples: dict[tuple[int, int], list[_Sample]] = {key: [] for key in episode_steps}
    tools = read_tools(arms)
    targets = read_targets(names, poses)
    last_step = max((steps[-1] for steps in episode_steps.values()), default=-1)
    for step in play.steps(last_step):
        for (env, episode), steps in episode_steps.items():
            if step.number in steps:
                sample = _Sample(step.action[env], tools[:, env], targets[:, env])
                samples[env, episode].append(sample)
            if step.number == steps[-1]:
                yield _source(samples.pop((env, episode)), arms)
        tools = read_tools(arms)
        targets = read_targets(names, poses)


def _source(samples: Sequence[_Sample], arms: Sequence[ControlledArm]) -> Source:
    actions = np.array([sample.action for sample in samples])
    tools = np.moveaxis(np.array([sample.tools for sample in samples]), 1, 0)
    targets = np.moveaxis(np.array([sample.targets for sample in samples]), 1, 0)
    motions = [
        _split(tool, targets, _closed(arm, actions)) for arm, tool in zip(arms, tools, strict=True)
    ]
    segments = []
    for motion in motions:
        holds_of_others = [hold for other in motions if other is not motion for hold in other.holds]
        segments.append(
            tuple(
                replace(segment, follows=any(_is_held(segment, hold) for hold in holds_of_others))
                for segment in motion.segments
            )
        )
    return Source(actions, tools, targets, tuple(segments))


def _is_held(segment: Segment, hold: Segment) -> bool:
    """Whether another arm holds the target of a segment meanwhile."""
    overlap = hold.start < segment.stop and segment.start < hold.stop
    return overlap and segment.target == hold.target


def _closed(arm: ControlledArm, actions: F64) -> NDArray[np.bool_]:
    """(T,) whether the gripper of an arm is commanded to close."""
    if arm.gripper is None:
        return np.zeros(len(actions), np.bool_)
    middle = 0.5 * (np.asarray(arm.gripper.low) + np.asarray(arm.gripper.high))
    return np.asarray((actions[:, arm.fingers] < middle).all(axis=1))


@dataclass(slots=True)
class _Motion:
    """The motion of one arm in an episode.

    Attributes:
        segments: Its segments, in order.
        holds: When it holds which target; each is a `Segment`.
    """

    segments: list[Segment] = field(default_factory=list)
    holds: list[Segment] = field(default_factory=list)


def _split(tool: F64, targets: F64, closed: NDArray[np.bool_]) -> _Motion:
    """Split the motion (T, 7) of a tool where its gripper closes or opens."""
    distances = np.linalg.norm(targets[1:, :, :3] - tool[:, :3], axis=-1)  # without the world
    motion = _Motion()
    num_steps = len(tool)
    start = 0
    held: int | None = None
    for event in (np.flatnonzero(closed[1:] != closed[:-1]) + 1).tolist():
        target = _nearest(distances[:, event : event + 1], held)
        moved_on = np.linalg.norm(tool[event:, :3] - tool[event, :3], axis=1) > _MOVED_ON
        stop = num_steps
        if moved_on.any():
            stop = event + int(moved_on.argmax())
        if stop > start:
            motion.segments.append(Segment(start, stop, target))
        if held is not None:
            motion.holds[-1] = replace(motion.holds[-1], stop=event)
            held = None
        # The world cannot be held.
        if closed[event] and target > 0:
            held = target
            motion.holds.append(Segment(event, num_steps, target))
        start = max(start, stop)
    if start < num_steps:
        target = _nearest(distances[:, start:], held)
        motion.segments.append(Segment(start, num_steps, target))
    return motion


def _nearest(distances: F64, held: int | None) -> int:
    """The target that a tool comes nearest to; 0, the world, if there is only the held one.

    Args:
        distances: (k - 1, steps) from each target but the world.
        held: The target that the tool holds.
    """
    nearest = distances.min(axis=1)
    if held is not None:
        nearest[held - 1] = np.inf
    if np.isinf(nearest).all():
        return 0
    return 1 + int(nearest.argmin())
