"""What data sets say of a log's task, its robot and its actions, each in the format's own place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import PurePath
from typing import Any

from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.utils.errors import ConfigError

__all__ = ["action_names", "describe_action", "instruction_of", "require_unique", "robot_of"]

_VALUE = "value = centre + scale x action; a delta is added to its reference in each control step"


def action_names(log: RecordedLog, width: int) -> list[str]:
    """Names of an action's `width` numbers, ``tool/x``; ``action[0]`` where the log has none."""
    names = [column["name"] for column in log.header.action]
    return names if len(names) == width else [f"action[{i}]" for i in range(width)]


def describe_action(log: RecordedLog) -> dict[str, Any]:
    """What the action is: how often it is given, and of each number the meaning.

    ``columns`` has the entries of `ActionColumn`; it is empty for logs that do not say it.
    """
    return {
        "rate_hz": round(1.0 / log.dt, 9),
        "value": _VALUE,
        "columns": list(log.header.action),
    }


def instruction_of(log: RecordedLog) -> str:
    """The sentence that describes a log's task: its description, else its name."""
    said = _task(log).get("description")
    return said if isinstance(said, str) and said else log.task


def robot_of(log: RecordedLog) -> str | None:
    """The type of robot: its uid; of several robots the names of their files, joined by "+"."""
    task = _task(log)
    robot, several = task.get("robot"), task.get("robots")
    if isinstance(robot, dict) and robot.get("uid") is not None:
        return str(robot["uid"])
    if not isinstance(several, dict) or not several:
        return None
    return "+".join(_kind(uid, cfg) for uid, cfg in several.items())


def _kind(uid: str, cfg: Any) -> str:
    """The name of a robot's file, without folder and suffix; the uid if it has none."""
    path = cfg.get("fpath") if isinstance(cfg, dict) else None
    return PurePath(path).stem if isinstance(path, str) and path else str(uid)


def _task(log: RecordedLog) -> dict[str, Any]:
    task: Any = log.config.get("task")
    return task if isinstance(task, dict) else {}


def require_unique(names: Iterable[str], key: Callable[[str], str], format: str) -> dict[str, str]:
    """Name in a format of each entry or camera.

    Args:
        names: The names here.
        key: Returns the name in the format.
        format: The format, for the message.

    Raises:
        ConfigError: If two of them would be one.
    """
    keys = {name: key(name) for name in names}
    twice = [one for one, count in Counter(keys.values()).items() if count > 1]
    if twice:
        both = " and ".join(repr(name) for name, one in keys.items() if one == twice[0])
        raise ConfigError(
            f"{format}: {both} would both be {twice[0]!r}, and one would be lost: rename one"
        )
    return keys
