"""What data sets say of a log's task, its robot and its actions, each in the format's own place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import PurePath
from typing import Any

from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.utils.errors import ConfigError

__all__ = ["action_names", "describe_action", "instruction_of", "require_unique", "robot_of"]

_ANY_ROBOT = "robot"
"""What tasks call their robot, which any embodiment may be."""
_VALUE = "value = centre + scale x action; a delta is added to its reference in each control step"


def action_names(log: RecordedLog, width: int) -> list[str]:
    """Names of an action's `width` numbers, ``tool/x``; ``action[0]`` where the log has none."""
    names = [column["name"] for column in log.header.action]
    if len(names) == width:
        return names
    return [f"action[{i}]" for i in range(width)]


def describe_action(log: RecordedLog) -> dict[str, Any]:
    """Describe the action: how often one is given, and what each of its numbers means.

    ``columns`` has the entries of `ActionColumn`; it is empty for logs without them.
    """
    return {
        "rate_hz": round(1.0 / log.dt, 9),
        "value": _VALUE,
        "columns": list(log.header.action),
    }


def instruction_of(log: RecordedLog) -> str:
    """The sentence that describes a log's task: its description, else its name."""
    description = _task(log).get("description")
    if isinstance(description, str) and description:
        return description
    return log.task


def robot_of(log: RecordedLog) -> str | None:
    """The type of robot: its uid, or the name of its file where tasks call it ``robot``.

    Of several robots it is the names of their files, joined by "+".
    """
    task = _task(log)
    robot = task.get("robot")
    if isinstance(robot, dict) and robot.get("uid") is not None:
        uid = str(robot["uid"])
        return _file_name(uid, robot).lower() if uid == _ANY_ROBOT else uid
    robots = task.get("robots")
    if not isinstance(robots, dict) or not robots:
        return None
    return "+".join(_file_name(uid, cfg) for uid, cfg in robots.items())


def _file_name(uid: str, cfg: Any) -> str:
    """The name of a robot's file, without folder and suffix; the uid if it has none."""
    path = cfg.get("fpath") if isinstance(cfg, dict) else None
    if isinstance(path, str) and path:
        return PurePath(path).stem
    return str(uid)


def _task(log: RecordedLog) -> dict[str, Any]:
    """The task's part of the config; empty if the log has none."""
    task: Any = log.config.get("task")
    if not isinstance(task, dict):
        return {}
    return task


def require_unique(names: Iterable[str], key: Callable[[str], str], format: str) -> dict[str, str]:
    """Name in a format of each entry or camera.

    Args:
        names: The names here.
        key: Returns the name in the format.
        format: The format, for the message.

    Raises:
        ConfigError: If two of them have the same name in the format.
    """
    keys = {name: key(name) for name in names}
    for duplicate, count in Counter(keys.values()).items():
        if count > 1:
            both = " and ".join(repr(name) for name, new in keys.items() if new == duplicate)
            raise ConfigError(
                f"{format}: {both} would both be {duplicate!r}, and one would be lost: rename one"
            )
    return keys
