"""LeRobot data sets: folders for training with LeRobot, with the episodes of logs.

`write_lerobot` writes what a log has: states, and the pictures of the task's cameras (camera
sensors, and those of the event `record_camera_data`), rendered from the states. The task's
observations are in `episode_formats.lerobot`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.lerobot_env import image_key
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.recording.export.format_register import log_format
from embodichain.recording.export.lerobot_writer import Feature, LeRobotWriter, whole_fps
from embodichain.recording.export.log_parts import Part, demonstrations
from embodichain.recording.export.meaning import (
    describe_action,
    instruction_of,
    require_unique,
    robot_of,
)
from embodichain.recording.film.frames import FilmCamera, cameras_of, frames
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.api import Log
from embodichain.recording.read.episodes import LogEpisode
from embodichain.recording.read.playback import Playback, Span
from embodichain.recording.views.channels import scalar_joints

__all__ = ["write_lerobot"]

_log = logging.getLogger(__name__)
_BLOCK_BYTES = 2**28
"""Approximate size of the data in memory at a time."""

Columns = Mapping[str, NDArray[Any]]
"""Field of a log, `done` or `success` to (T, K) values of one episode."""
Demonstration = tuple[LogEpisode, range]


class _Source(NamedTuple):
    """The columns of one feature: fields with the indices of their columns."""

    feature: Feature
    fields: Mapping[str, list[int]]

    def of(self, columns: Columns) -> NDArray[Any]:
        """Return its (T, K) values."""
        parts = [columns[field][:, ids] for field, ids in self.fields.items()]
        whole: NDArray[Any] = np.concatenate(parts, axis=1)
        return whole


@log_format("lerobot", suffix="", requires="embodichain[lerobot]", pictures=True)
def write_lerobot(log: Log, part: Part, path: Path) -> None:
    """Write the episodes of a part into a new folder, by environment, then in time.

    Raises:
        ConfigError: If pyarrow, pandas or, with cameras, the extra `video` is not installed, there
            is no episode, the control frequency is not a whole number of Hz, there is no such
            camera, or its width or height is odd.
        LogError: If the log lacks steps of an episode.
        RenderError: If there are cameras, and no OpenGL library works here.
    """
    fps = whole_fps(log.dt)
    chosen = demonstrations(log, part)
    sources, cameras = _sources(log), dict(_cameras(log, part))
    features = {key: source.feature for key, source in sources.items()}
    sizes = {key: camera.size for key, camera in cameras.items()}
    if "action" in features:
        features["action"] = features["action"]._replace(info=describe_action(log))
    else:
        _log.warning("%s has no actions: the data set has no feature 'action'", log.path)
    instruction = instruction_of(log)
    with ExitStack() as stack:
        writer = LeRobotWriter(path, features, sizes, fps, robot_of(log))
        stack.enter_context(writer)
        renderer = None
        if cameras:
            renderer = stack.enter_context(closing(OffscreenRenderer(log.model)))
        for (episode, steps), columns in _read(log, chosen, sources):
            values = {key: source.of(columns) for key, source in sources.items()}
            source: dict[str, int | str] = {"env": episode.env, "episode": episode.episode}
            source["first_step"] = steps.start
            pictures: Iterable[list[NDArray[np.uint8]]] = ()
            if renderer is not None:
                span = Span(steps.start, steps.stop - 1)
                playback = Playback(log, episode.env)
                drawn = frames(renderer, playback, [*cameras.values()], span)
                pictures = (frame.pictures for frame in drawn)
            writer.add(values, source, instruction, pictures)
        writer.finish()


def _sources(log: Log) -> dict[str, _Source]:
    """Return the features with their columns: joints are the robot's state, the rest the scene's.

    States are before physics, rewards and ends after it, hence ``next``.
    """
    joints, model = list(scalar_joints(log.model).values()), log.model
    positions, velocities = model.jnt_qposadr[joints].tolist(), model.jnt_dofadr[joints].tolist()
    floating = sorted(set(range(model.nq)) - set(positions))
    whole = {name: list(range(len(columns))) for name, columns in log.columns.items()}
    environment = {"qpos": floating, **{k: whole.get(k, []) for k in ("mocap_pos", "mocap_quat")}}
    made = {
        "observation.state": {"qpos": positions},
        "observation.velocity": {"qvel": velocities},
        "observation.environment_state": environment,
        "action": {"actions": whole.get("actions", [])},
    }
    sources = {}
    for key, columns in made.items():
        there = {field: ids for field, ids in columns.items() if ids}
        names = [log.columns[field][i].name for field, ids in there.items() for i in ids]
        if names:
            sources[key] = _Source(Feature("float32", names), there)
    return sources | {
        "next.reward": _Source(Feature("float32", ["rewards"]), {"rewards": [0]}),
        "next.done": _Source(Feature("bool", ["done"]), {"done": [0]}),
        "next.success": _Source(Feature("bool", ["success"]), {"success": [0]}),
    }


def _read(
    log: Log, chosen: list[Demonstration], sources: Mapping[str, _Source]
) -> Iterator[tuple[Demonstration, Columns]]:
    """Yield the episodes with their columns; reads as many environments at once as memory holds."""
    fields = {field for source in sources.values() for field in source.fields}
    fields |= {"terminated", "truncated"}
    names = [name for name in log.columns if name in fields]
    first, last = min(s.start for _, s in chosen), max(s.stop for _, s in chosen)
    width = sum(len(log.columns[name]) for name in names)
    most = max(1, _BLOCK_BYTES // (8 * width * (last - first)))
    envs = sorted({episode.env for episode, _ in chosen})
    for at in range(0, len(envs), most):
        block = envs[at : at + most]
        data = log.read(names, block, None, first, last)
        for episode, steps in chosen:
            if episode.env not in block:
                continue
            rows = slice(*np.searchsorted(data.steps, [steps.start, steps.stop]).tolist())
            if rows.stop - rows.start != len(steps):
                which = f"episode {episode.episode} of environment {episode.env}"
                raise LogError(f"{log.path} lacks steps of {which}")
            column = block.index(episode.env)
            found = {name: data[name][rows, column] for name in names}
            found["done"] = found["terminated"] | found["truncated"]
            found["success"] = np.zeros(len(steps), np.bool_)
            found["success"][-1] = bool(episode.success) and steps[-1] == episode.last_step
            yield (
                (episode, steps),
                {name: v if v.ndim > 1 else v[:, None] for name, v in found.items()},
            )


def _cameras(log: Log, part: Part) -> Iterator[tuple[str, FilmCamera]]:
    chosen = cameras_of(log, part.cameras, part.size)
    if part.cameras is None:
        filmed = dict(_event_cameras(log, part.size))
        chosen |= {name if name not in chosen else f"{name}_film": c for name, c in filmed.items()}
    keys = require_unique(chosen, image_key, "lerobot")
    for name, camera in chosen.items():
        yield f"observation.images.{keys[name]}", camera


def _event_cameras(log: Log, size: tuple[int, int] | None) -> Iterator[tuple[str, FilmCamera]]:
    """Name and camera of each event `record_camera_data`."""
    from embodichain.lab.gym.envs.mdp.events.record import filmed_from

    task = log.config.get("task")
    events = task.get("events") if isinstance(task, dict) else None
    seen: set[str] = set()
    for uid, event in (events or {}).items():
        if not isinstance(event, dict) or event.get("func") != "record_camera_data":
            continue
        params = event.get("params") or {}
        name = params.get("name") or "default"
        name = name if name not in seen else f"{name}_{uid}"
        seen.add(name)
        width, height = size or map(int, params.get("resolution") or (640, 480))
        look = params.get("camera")
        if look is None:
            where = {key: params.get(key) for key in ("eye", "target", "up", "intrinsics")}
            look = filmed_from((width, height), **where)
        yield name, FilmCamera(look, (width, height))
