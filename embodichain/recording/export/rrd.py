"""Rerun: the scene in 3D, joints, actions, rewards and episodes as curves, events as text.

Entities: ``/world/env_I/UID/LINK``, and below ``/env_I``: ``joint_positions``,
``joint_velocities``, ``actions``, ``reward``, ``metrics`` (of viewed environments),
``episode/return``, ``episode/length``, ``log``. The file brings the layout that shows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.arrays import LogArrays
from embodichain.recording.export.formats import Part, required
from embodichain.recording.export.rrd_scene import Scene
from embodichain.recording.export.rrd_stream import Stream
from embodichain.recording.export.tables import about
from embodichain.recording.views.log_lines import event_text
from embodichain.recording.views.messages import FrameTransforms
from embodichain.recording.views.motion import scalar_joints

__all__ = ["write"]

_FROM = np.array([1.0, -1.2, 0.8])
"""Where the eye is, seen from the middle of the scene."""


def write(log: Log, part: Part, path: Path) -> None:
    """Write the environment that is named, else those that were viewed.

    Raises:
        ConfigError: If rerun is not installed.
    """
    envs = [part.env] if part.env is not None else log.header.view_envs or [0]
    fields = {"qpos", "qvel", "actions", "rewards"}
    names = [name for name in log.columns if name in fields]
    offsets = _offsets(log) if len(envs) > 1 else {}
    places = np.array([offsets.get(env, np.zeros(3)) for env in envs])
    stream = Stream(log.header, _layout(log.model, envs, places))
    stream.about(about(log))
    stream.log("world", stream.rr.ViewCoordinates.RIGHT_HAND_Z_UP, None)
    for env, place in zip(envs, places, strict=True):
        Scene(stream, log, env, place).send(part)
    curves = [_Curves(stream, log, env, column) for column, env in enumerate(envs)]
    first = last = -1
    for data in log.parts(names, envs, part.episode, part.start, part.stop):
        first = int(data.steps[0]) if first < 0 else first
        last = int(data.steps[-1])
        for of_env in curves:
            of_env.add(data)
    for env in envs:
        _tell(stream, log, env, first, last)
    stream.save(path)


def _offsets(log: Log) -> dict[int, NDArray[np.float64]]:
    """Positions of the environments for viewers, from the first message of `/tf`."""
    for topic, _, payload in log.raw_messages():
        if topic == "/tf":
            message = FrameTransforms.FromString(bytes(payload))
            return {
                int(t.child_frame_id.removeprefix("env_")): np.array(
                    [t.translation.x, t.translation.y, t.translation.z]
                )
                for t in message.transforms
                if t.parent_frame_id == "world"
            }
    return {}


class _Curves:
    """The curves of one environment."""

    def __init__(self, stream: Stream, log: Log, env_id: int, column: int) -> None:
        self._stream, self._column, self._root = stream, column, f"/env_{env_id}"
        joints = scalar_joints(log.model)
        ids = np.array(list(joints.values()), np.int64)
        self._of: dict[str, tuple[str, Any]] = {
            "qpos": ("joint_positions", log.model.jnt_qposadr[ids]),
            "qvel": ("joint_velocities", log.model.jnt_dofadr[ids]),
            "actions": ("actions", slice(None)),
        }
        for path in ("joint_positions", "joint_velocities"):
            stream.name(f"{self._root}/{path}", list(joints))
        stream.name(f"{self._root}/actions", [c.name for c in log.columns.get("actions", [])])
        stream.name(f"{self._root}/reward", ["reward"])

    def add(self, data: LogArrays) -> None:
        """Add the steps of `data`."""
        for field, (path, columns) in self._of.items():
            if field in data.values:
                values = data[field][:, self._column][:, columns]
                self._stream.curves(f"{self._root}/{path}", data.steps, values)
        rewards = data["rewards"][:, self._column, None]
        self._stream.curves(f"{self._root}/reward", data.steps, rewards)


def _tell(stream: Stream, log: Log, env: int, first: int, last: int) -> None:
    """Add what is not there in every step: sampled metrics, episodes that ended, events."""
    root = f"/env_{env}"
    if env in log.header.view_envs:
        steps, values = log.metrics(env)
        chosen = (steps >= first) & (steps <= last)
        names = [name for name in values if name not in ("reward", "terminated", "truncated")]
        if names and chosen.any():
            stream.name(f"{root}/metrics", names)
            table = np.stack([values[name][chosen] for name in names], axis=1)
            stream.curves(f"{root}/metrics", steps[chosen], table)
    ended = [
        e
        for e in log.episodes
        if e.env == env and first <= e.last_step <= last and (e.terminated or e.truncated)
    ]
    at = np.array([e.last_step for e in ended], np.int64)
    for name, numbers in (
        ("return", [e.total_reward for e in ended]),
        ("length", [e.steps for e in ended]),
    ):
        stream.curves(f"{root}/episode/{name}", at, np.array(numbers)[:, None])
    stream.lines(f"{root}/log", _lines(log, env, first, last))


def _lines(log: Log, env: int, first: int, last: int) -> list[tuple[int, str, str]]:
    """What happened: step, level, text; in the order of steps."""
    found = [
        (event.step, "INFO", event_text(env, event.term, event.mode, _drawn(event, env)))
        for event in log.events()
        if event.env_ids is None or env in event.env_ids
    ]
    for episode in log.episodes:
        if episode.env == env and (episode.terminated or episode.truncated):
            how = "terminated" if episode.terminated else "truncated"
            text = (
                f"environment {env}: episode {episode.episode} {how} after {episode.steps} steps, "
                f"return {episode.total_reward:.4g}"
            )
            found.append((episode.last_step, "INFO", text))
    return sorted((line for line in found if first <= line[0] <= last), key=lambda line: line[0])


def _drawn(event: Any, env: int) -> dict[str, NDArray[np.float64]]:
    """What an event drew for an environment."""
    row = env if event.env_ids is None else int(np.flatnonzero(event.env_ids == env)[0])
    return {name: values[row] for name, values in event.drawn.items()}


def _layout(model: mujoco.MjModel, envs: Sequence[int], places: NDArray[np.float64]) -> Any:
    """Return what a viewer shows at first: the scene, beside it joints, reward and what happened.

    Args:
        model: The scene's model.
        envs: The environments that are shown; curves are those of the first.
        places: (n, 3) where each stands, metres.

    Raises:
        ConfigError: If rerun is not installed.
    """
    rrb: Any = required("rerun.blueprint", "rrd")
    center = np.array(model.stat.center, np.float64) + places.mean(axis=0)
    size = float(model.stat.extent) + float(np.linalg.norm(np.ptp(places, axis=0)))
    eye = center + size * _FROM / np.linalg.norm(_FROM)
    first = f"/env_{envs[0]}"
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(
                origin="/world",
                name="scene",
                eye_controls=rrb.EyeControls3D(position=eye, look_target=center, eye_up=(0, 0, 1)),
            ),
            rrb.Vertical(
                rrb.TimeSeriesView(
                    origin=f"{first}/joint_positions", name="joint positions (rad, m)"
                ),
                rrb.TimeSeriesView(origin=f"{first}/reward", name="reward"),
                rrb.Tabs(
                    rrb.TextLogView(origin=f"{first}/log", name="log"),
                    rrb.TimeSeriesView(origin=f"{first}/metrics", name="metrics"),
                    rrb.TimeSeriesView(origin=f"{first}/episode", name="episodes"),
                    rrb.TimeSeriesView(origin=f"{first}/actions", name="actions"),
                ),
                row_shares=[2, 1, 1],
            ),
            column_shares=[3, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="sim_time"),
    )
