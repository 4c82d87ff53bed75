"""`read_sources`: the tool's motions in successful episodes of a log, split into segments.

A segment is a part of an episode in which an arm acts on one target: an entity, a link of an
articulation, or the pose of a command. Segments end where the gripper has closed or opened and the
tool moves on. Their target is what the tool is nearest to at that moment, and in the last one,
where it comes nearest, other than what it holds. If there is nothing else, it is the world.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.expert.arms import Arm, arms_of
from embodichain.lab.gym.expert.targets import WORLD, TargetPoses
from embodichain.recording.demos.collection import is_collection, read_collection
from embodichain.recording.demos.reenactment import Reenactment
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.api import F64

__all__ = ["Segment", "Source", "read_sources", "read_tools", "target_poses"]

_MOVED = 0.005
"""M: a tool that is farther from where its gripper acted has moved on."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of the motion of one arm.

    Attributes:
        start: Its first control step.
        stop: Its last one plus 1.
        target: Index of what it acts on.
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
    names = []
    links = [f"{uid}/{link}" for uid, a in env.sim.articulations.items() for link in a.link_names]
    for name in (WORLD, *env.sim.rigid_objects, *links, *env.command_manager.terms):
        try:
            poses.add(name, "")
        except ConfigError:  # a command that is no pose
            continue
        names.append(name)
    return names, poses


def read_tools(arms: Sequence[Arm]) -> F64:
    """(arms, N, 7) poses of the tools."""
    found = [arm.term.solver.forward(arm.asset.read_qpos()) for arm in arms]
    return np.array([np.concatenate(pair, axis=1) for pair in found])


def read_sources(path: str | Path, most: int) -> tuple[list[str], list[Source]]:
    """Read successful episodes, by stepping their task through the recorded actions.

    Args:
        path: A collection, a log, or the folder of a run.
        most: Number of episodes that are read at most, the first ones.

    Returns:
        The names of the targets, and the episodes.

    Raises:
        ConfigError: There is no successful episode, or the log cannot be reenacted.
    """
    names: list[str] = []
    found: list[Source] = []
    for log, wanted, numbers in _chosen(Path(path), most):
        with log, Reenactment(log, numbers) as play:
            names, poses = target_poses(play.env)
            arms = [arm for _, arm in arms_of(play.env)]
            found += _read(play, arms, names, poses, wanted)
    if not found:
        raise ConfigError(f"{path} has no successful episode")
    return names, found


Wanted = dict[tuple[int, int], range]
"""(environment, episode) -> its control steps in the log."""


def _chosen(
    path: Path, most: int
) -> Iterator[tuple[RecordedLog, Wanted, dict[tuple[int, int], int] | None]]:
    """Each log with the episodes to read, and the numbers of its random streams."""
    if not (path.is_dir() and is_collection(path)):
        log = RecordedLog(path)
        won = sorted((e for e in log.episodes if e.success), key=lambda e: e.last_step)[:most]
        yield log, {(e.env, e.episode): range(e.first_step, e.last_step + 1) for e in won}, None
        return
    listed = read_collection(path)[:most]
    everything = read_collection(path, failures=True)
    for name in sorted({episode.log for episode in listed}):
        yield (
            RecordedLog(path / name),
            {
                (e.env, e.episode): range(e.first_step, e.first_step + e.steps)
                for e in listed
                if e.log == name
            },
            {(e.env, e.episode): e.attempt for e in everything if e.log == name},
        )


def _read(
    play: Reenactment, arms: Sequence[Arm], names: Sequence[str], poses: TargetPoses, wanted: Wanted
) -> Iterator[Source]:
    """The wanted episodes of a log, in the order in which they end."""

    def now() -> tuple[F64, F64]:
        return read_tools(arms), np.array([np.concatenate(poses(n), axis=1) for n in names])

    parts: dict[tuple[int, int], list[tuple[F64, F64, F64]]] = {key: [] for key in wanted}
    tools, targets = now()
    for step in play.steps(max((steps[-1] for steps in wanted.values()), default=-1)):
        for (env, episode), steps in wanted.items():
            if step.number in steps:
                part = step.action[env], tools[:, env], targets[:, env]
                parts[env, episode].append(part)
            if step.number == steps[-1]:
                yield _source(parts.pop((env, episode)), arms)
        tools, targets = now()


def _source(parts: Sequence[tuple[F64, F64, F64]], arms: Sequence[Arm]) -> Source:
    actions, tools, targets = (np.array(column) for column in zip(*parts, strict=True))
    tools = np.moveaxis(tools, 1, 0)
    targets = np.moveaxis(targets, 1, 0)
    split = [
        _segments(tool, targets, _closed(arm, actions))
        for arm, tool in zip(arms, tools, strict=True)
    ]
    for a, (segments, _) in enumerate(split):
        others = [hold for b, (_, holds) in enumerate(split) if b != a for hold in holds]
        for i, one in enumerate(segments):
            segments[i] = replace(one, follows=any(_is_held(one, hold) for hold in others))
    followed = tuple(tuple(segments) for segments, _ in split)
    return Source(actions, tools, targets, followed)


def _is_held(segment: Segment, hold: Segment) -> bool:
    """Whether the target of a segment is what another arm holds meanwhile."""
    together = hold.start < segment.stop and segment.start < hold.stop
    return segment.target == hold.target and together


def _closed(arm: Arm, actions: F64) -> NDArray[np.bool_]:
    """(T,) whether the gripper of an arm is commanded to close."""
    if arm.gripper is None:
        return np.zeros(len(actions), np.bool_)
    middle = 0.5 * (np.asarray(arm.gripper.low) + np.asarray(arm.gripper.high))
    return np.asarray((actions[:, arm.fingers] < middle).all(axis=1))


def _segments(
    tool: F64, targets: F64, closed: NDArray[np.bool_]
) -> tuple[list[Segment], list[Segment]]:
    """Split the motion (T, 7) of a tool; also returns when it holds what."""
    distances = np.linalg.norm(targets[1:, :, :3] - tool[:, :3], axis=-1)  # without the world
    found: list[Segment] = []
    holds: list[Segment] = []
    start = 0
    held = -1

    def nearest(first: int, last: int) -> int:
        """The target that the tool comes nearest to; 0 if there is only what it holds."""
        near = distances[:, first:last].min(axis=1)
        near[held - 1 :][: held > 0] = np.inf
        return 0 if np.isinf(near).all() else 1 + int(near.argmin())

    for event in (np.flatnonzero(closed[1:] != closed[:-1]) + 1).tolist():
        target = nearest(event, event + 1)
        away = np.linalg.norm(tool[event:, :3] - tool[event, :3], axis=1) > _MOVED
        stop = event + int(away.argmax()) if away.any() else len(tool)
        if stop > start:
            found.append(Segment(start, stop, target))
        if held > 0:
            holds[-1] = replace(holds[-1], stop=event)
        held = target if closed[event] else -1
        if held > 0:
            holds.append(Segment(event, len(tool), held))
        start = max(start, stop)
    if start < len(tool):
        found.append(Segment(start, len(tool), nearest(start, len(tool))))
    return found, holds
