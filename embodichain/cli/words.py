"""Words of the command line: overrides, the name of a log, a pair of numbers."""

from __future__ import annotations

import itertools
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from embodichain.utils.errors import ConfigError

__all__ = [
    "ADVICE_ELSEWHERE",
    "EVERYDAY_KEYS",
    "NAMES_ELSEWHERE",
    "ROOT_KEYS",
    "STILL_GOING",
    "is_still_written",
    "log_of",
    "log_warnings",
    "pair",
    "split_overrides",
]

EVERYDAY_KEYS = (
    "task",
    "num_envs",
    "episodes",
    "max_steps",
    "total_timesteps",
    "seed",
    "policy",
    "record",
    "viewer",
    "device",
    "sim",
    "output_dir",
)
"""Keys of the root that the help lists."""
ROOT_KEYS = (
    *EVERYDAY_KEYS,
    "algo",
    "video",
    "resume",
    "dataset",
    "scene_png",
    "allow_changed",
    "trust",
    "experiment",
)
"""Keys that are flags of other tools."""
NAMES_ELSEWHERE = {
    "env": "task",
    "env_id": "task",
    "n_envs": "num_envs",
    "nenvs": "num_envs",
    "num_env": "num_envs",
    "timesteps": "total_timesteps",
    "total_steps": "total_timesteps",
    "num_timesteps": "total_timesteps",
}
"""Flags of other tools, and the key that is the same here."""
ADVICE_ELSEWHERE = {
    "headless": "leave it out, only viewer=native opens a window",
    "max_iterations": "write total_timesteps=N, the steps of all environments together",
}
"""Flags of other tools that no key is the same as, and what to do instead."""


_ENTRY = re.compile(r"\{?\w+:")
"""The beginning of a map's entry; ``{`` stays where braces are within braces."""


def split_overrides(words: tuple[str, ...]) -> list[str]:
    """Return words as overrides; a word without ``=`` is the name of the task.

    Raises:
        ConfigError: More than one bare word, or a map or list that the shell has split.
    """
    _check_quotes(words)
    _check_braces(words)
    if "=" in words:
        index = words.index("=")
        assignment = "".join(words[max(index - 1, 0) : index + 2])
        raise ConfigError(f"write {assignment}, without blanks around =")
    tasks = [word for word in words if "=" not in word and not word.startswith("~")]
    _check_blanks(words, tasks)  # its messages are more specific
    if len(tasks) > 1:
        raise ConfigError(f"one task at a time: {', '.join(tasks)}. Values are given as key=value")
    overrides = [word for word in words if word not in tasks]
    return [*(f"task={task}" for task in tasks), *overrides]


def _check_blanks(words: tuple[str, ...], bare_words: list[str]) -> None:
    """Refuse ``task reach``, ``task: reach``, ``task= reach`` and ``task =reach``, by the form."""
    for word, value in itertools.pairwise(words):
        key = word.rstrip("=:")
        is_key = word.endswith("=") or (word in bare_words and key in ROOT_KEYS)
        is_split = value.startswith("=") or (is_key and value in bare_words)
        if not is_split:
            continue
        assignment = f"{key}={value.lstrip('=')}"
        if _has_open_brackets(assignment):
            following = words[words.index(value) + 1 :]
            assignment = _quoted(" ".join([assignment, *following]))
        raise ConfigError(f"write {assignment}, without a blank after the key")


def _check_quotes(words: tuple[str, ...]) -> None:
    """Refuse ``KEY={func: NAME}`` without quotes, of which a shell makes two words."""
    for i, word in enumerate(words):
        if "=" not in word or not _has_open_brackets(word):
            continue
        assignment = word
        for following in words[i + 1 :]:
            assignment += f" {following}"
            if _has_open_brackets(assignment):
                continue
            message = f"put quotes around it for your shell: {_quoted(assignment)}"
            if not word.startswith("+"):
                key = word.partition("=")[0]
                message += f"; a new entry is +{key}=..."
            raise ConfigError(message)
        raise ConfigError(f"{word!r} has a bracket without its other one")


def _check_braces(words: tuple[str, ...]) -> None:
    """Refuse ``KEY={func:NAME,weight:2}`` without quotes, of which bash makes a word an entry."""
    for word, following in itertools.pairwise(words):
        key, separator, value = word.partition("=")
        other_key, _, other_value = following.partition("=")
        is_same_key = bool(separator) and key == other_key
        if not (is_same_key and _ENTRY.match(value) and _ENTRY.match(other_value)):
            continue
        entries = [word.partition("=")[2] for word in words if word.startswith(f"{key}=")]
        whole = "..."
        if not any(entry.startswith("{") for entry in entries):  # else braces within braces
            whole = ", ".join(entry.replace(":", ": ", 1) for entry in entries)
        assignment = _quoted(f"{key}={{{whole}}}")
        raise ConfigError(f"your shell has split the braces: put quotes around it, {assignment}")


def _quoted(word: str) -> str:
    """Return a word in quotes for a shell, double ones if it has single ones."""
    has_special_signs = bool(set(word) & set('"$`\\'))
    if "'" in word and not has_special_signs:
        return f'"{word}"'
    return shlex.quote(word)


def _has_open_brackets(text: str) -> bool:
    """Whether brackets or quotes of a text are open at its end."""
    closing = {"{": "}", "[": "]", "(": ")"}
    still_open: list[str] = []
    quote = ""
    escaped = False
    for sign in text.partition("=")[2]:
        if escaped:
            escaped = False
        elif sign == "\\":
            escaped = True
        elif quote:
            if sign == quote:
                quote = ""
        elif sign in "'\"":
            quote = sign
        elif sign in closing:
            still_open.append(closing[sign])
        elif still_open and sign == still_open[-1]:
            still_open.pop()
    return bool(still_open)


def pair(option: str, text: str, form: str) -> tuple[int, int]:
    """Return the numbers of an option's value such as ``640x480``.

    Args:
        option: The option.
        text: Its value.
        form: The allowed form, for the message.

    Raises:
        ConfigError: The value has another form, or a number is 0.
    """
    numbers = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if numbers is None:
        raise ConfigError(f"{option} is {form}, not {text!r}")
    return int(numbers[1]), int(numbers[2])


STILL_GOING = "the run is still going"
"""What is said of a log that is incomplete because it is being written."""


class _Incomplete(Protocol):
    """A log, or the summary of one."""

    @property
    def path(self) -> Path: ...
    @property
    def complete(self) -> bool: ...
    @property
    def warnings(self) -> Sequence[object]: ...


def log_warnings(log: _Incomplete) -> Sequence[object]:
    """Return the warnings about a log; one whose run lasts is not damaged, but not complete yet."""
    if not log.complete and is_still_written(log.path):
        return [f"{STILL_GOING}; this is what it has written so far"]
    return log.warnings


def is_still_written(log: Path) -> bool:
    """Whether the run of a log lasts, so that the log is not complete yet."""
    from embodichain.config.run_folder import is_running

    return is_running(log.resolve().parent)


def log_of(name: str) -> Path:
    """Return the log of a name: a file, a run's folder, or ``last`` for the newest run.

    Temporary files of processes that were killed are removed from its folder.

    Raises:
        ConfigError: There is no log yet, no such file, or the folder has none.
    """
    from embodichain.config.run_folder import LOG, SHARDS, newest_run, perhaps_last
    from embodichain.utils.system.atomic import remove_abandoned

    path = newest_run("outputs", LOG, SHARDS) if name == "last" else Path(name)
    if path is None:
        raise ConfigError("no run in outputs has a log yet: embodichain run task=NAME")
    if name == "last":
        from embodichain.cli.terminal.last import announce_last

        announce_last(path)
    if not path.exists():
        raise ConfigError(f"{name} does not exist{perhaps_last(name)}")
    remove_abandoned(path if path.is_dir() else path.parent)
    if not path.is_dir():
        return path
    log = path.resolve() / LOG
    if not log.exists() and (path / SHARDS).exists():
        return path.resolve() / SHARDS
    if not log.exists():
        raise ConfigError(f"{path.resolve()} has no {LOG}: {_why_no_log(path)}")
    return log


def _why_no_log(folder: Path) -> str:
    """Why a run's folder has no log, as its config says."""
    from embodichain.config.rerun import read_config
    from embodichain.config.run_folder import CONFIG, SUMMARY

    if not (folder / CONFIG).is_file():
        return f"it is not the folder of a run, which has a {CONFIG}"
    record = read_config(folder / CONFIG).get("record")
    if isinstance(record, dict) and record.get("format") == "none":
        return "it was run with record=none"
    if (folder / SUMMARY).is_file():
        return "the run failed before its log began, or the log was moved"
    return "the run ended, or was killed, before its log began"
