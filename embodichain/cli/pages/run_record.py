"""`RunRecord`: what the files of a run's folder say, without its log; read by every page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import yaml

from embodichain.config.composition.locate import display_path
from embodichain.config.run_folder import (
    CHECKPOINT,
    CONFIG,
    LATEST,
    LOG,
    SHARDS,
    SUMMARY,
    is_running,
)
from embodichain.utils.env_text import shown
from embodichain.utils.errors import ConfigError, EmbodichainError
from embodichain.utils.system.atomic import remove_abandoned

__all__ = ["Kind", "RunRecord", "named_damage", "read_json", "read_record", "read_text"]

EVALUATION = "eval.json"
Kind = Literal["run", "training", "evaluation", "collection"]
"""What a run was."""

_KINDS: dict[str, Kind] = {
    "augment": "collection",
    "collect": "collection",
    "eval": "evaluation",
    "train": "training",
}
"""Verb to the kind of its runs; those of others are runs."""
_SWEEP_FLAGS = frozenset({"-m", "--multirun"})
_WORDS_OF_A_SWEEP = ("hydra.", "hydra/")


@dataclass(frozen=True, slots=True)
class RunRecord:
    """The files of a run.

    Attributes:
        folder: The run's folder.
        kind: What kind of run it was.
        status: ``finished``, ``failed``, ``interrupted``, ...; without a result ``running`` or
            ``unfinished``.
        task: Name of the task.
        begun: When it began.
        config: Its resolved config, with ``<env NAME>`` for text of the environment.
        written_config: The same as written, with interpolations.
        overrides: What was typed.
        summary: `summary.json`; empty without it.
        evaluation: `eval.json`; empty without it.
        command: The words that repeat it, with paths that stay valid.
        working_dir: Where they were typed; None if that is not recorded.
    """

    folder: Path
    kind: Kind
    status: str
    task: str
    begun: datetime
    config: Mapping[str, Any]
    written_config: Mapping[str, Any]
    overrides: tuple[str, ...]
    summary: Mapping[str, Any]
    evaluation: Mapping[str, Any]
    command: tuple[str, ...]
    working_dir: Path | None

    @property
    def outcome(self) -> Mapping[str, Any]:
        """The summary, or of an evaluation its result."""
        return self.summary or self.evaluation

    @property
    def is_bad(self) -> bool:
        """Whether it failed, or did not end."""
        return self.status in ("failed", "unfinished")

    @property
    def log(self) -> Path | None:
        """What `recording.open` takes; None without a log."""
        for name in (LOG, SHARDS):
            if (self.folder / name).exists():
                return self.folder / name
        return None

    @property
    def policy_run(self) -> Path | None:
        """The folder of another training whose policy it played."""
        policy = self.written_config.get("policy")
        if not isinstance(policy, str):
            return None
        file = Path(policy)
        for folder in (file, *file.parents[:2]):
            if (folder / SUMMARY).is_file():
                return None if folder.resolve() == self.folder.resolve() else folder
        return None


def read_record(folder: Path) -> RunRecord:
    """Read the files of a run's folder, and remove what killed processes left there.

    Raises:
        ConfigError: If it is not a run's folder, or a file in it is damaged.
    """
    if not (folder / CONFIG).is_file():
        raise ConfigError(f"{folder} is not a run's folder: it has no {CONFIG}")
    remove_abandoned(folder)
    remove_abandoned((folder / CHECKPOINT).parent)
    config = _read_map(folder / CONFIG)
    summary = shown(read_json(folder / SUMMARY))
    evaluation = shown(read_json(folder / EVALUATION))
    overrides = tuple(map(str, _read_yaml(folder / "overrides.yaml") or []))
    words, working_dir = _typed(folder)
    outcome = summary or evaluation
    # The result of an evaluation has no status: it is written when it has finished.
    if outcome:
        status = str(outcome.get("status", "finished"))
    else:
        status = "running" if is_running(folder) else "unfinished"
    return RunRecord(
        folder=folder,
        kind=_kind_of(folder, words, summary, evaluation),
        status=status,
        task=str(outcome.get("task") or _task_of(folder, overrides)),
        begun=datetime.fromtimestamp((folder / CONFIG).stat().st_mtime),
        config=shown(config),
        written_config=config,
        overrides=overrides,
        summary=summary,
        evaluation=evaluation,
        command=_repeatable(words, config, overrides),
        working_dir=working_dir,
    )


def _kind_of(
    folder: Path,
    words: tuple[str, ...],
    summary: Mapping[str, Any],
    evaluation: Mapping[str, Any],
) -> Kind:
    from embodichain.recording.demos.collection import is_collection

    if is_collection(folder):
        return "collection"
    # A training may be evaluated in its own folder, which is then still a training's.
    if "algo" in summary or (folder / "progress.csv").exists():
        return "training"
    if evaluation:
        return "evaluation"
    verb = words[1] if len(words) > 1 else ""
    return _KINDS.get(verb, "run")


def _task_of(folder: Path, overrides: tuple[str, ...]) -> str:
    """The task of a run without a result: as it was typed, or from the folder's name."""
    for override in overrides:
        key, _, value = override.lstrip("+").partition("=")
        if key == "task":
            return value
    return folder.name.partition("_")[2] or folder.name


@contextmanager
def named_damage(folder: Path) -> Iterator[None]:
    """Raise an error of values that a run's files should not have as one about this run.

    Files of other versions, or that somebody has edited, have other keys and types.

    Raises:
        ConfigError: The error; names the folder.
    """
    try:
        yield
    except EmbodichainError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        text = f"the results in {folder} are damaged, or of another version: {error!r}"
        raise ConfigError(text) from error


# -- the command -----------------------------------------------------------------------------------


def _typed(folder: Path) -> tuple[tuple[str, ...], Path | None]:
    """The words of `command.txt`, and the working directory."""
    lines = read_text(folder / "command.txt").strip().rpartition("\n")
    try:
        words = tuple(shlex.split(lines[2]))
        place = shlex.split(lines[0])
    except ValueError as error:
        raise ConfigError(f"{folder / 'command.txt'} is damaged: {error}") from error
    working_dir = Path(place[1]) if len(place) == 2 and place[0] == "cd" else None
    return words, working_dir


def _repeatable(
    words: tuple[str, ...], config: Mapping[str, Any], overrides: tuple[str, ...]
) -> tuple[str, ...]:
    """The command of this run alone: of one job, not of its sweep, and with paths for `last`.

    Args:
        words: As they were typed.
        config: The resolved config, which has the paths of a policy and of a run to resume.
        overrides: As Hydra has them.
    """
    if _SWEEP_FLAGS & set(words):
        own = [o.lstrip("+") for o in overrides if not o.startswith(_WORDS_OF_A_SWEEP)]
        words = (*words[:2], *own)
    return tuple(_with_path(word, config) for word in words)


def _with_path(word: str, config: Mapping[str, Any]) -> str:
    """A word in which ``last`` or the link ``latest`` is the path that was meant."""
    key, is_override, value = word.partition("=")
    if not is_override:
        key, value = "policy", word  # `eval RUN`: the run's policy is evaluated
    if value != "last" and LATEST not in Path(value).parts:
        return word
    path = config.get(key)
    if not isinstance(path, str) or path == "last" or LATEST in Path(path).parts:
        return word
    if not is_override:
        path = path.removesuffix(f"/{CHECKPOINT}")
    return f"{key}={path}" if is_override else display_path(Path(path))


# -- files -----------------------------------------------------------------------------------------


def read_text(path: Path) -> str:
    """Return the content of a file, or an empty string without it.

    Raises:
        ConfigError: It cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error}") from error


def read_json(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file, or an empty one without it.

    Raises:
        ConfigError: The file is damaged.
    """
    try:
        data = json.loads(read_text(path) or "{}")
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path} is damaged: it is not a map")
    return data


def _read_yaml(path: Path) -> Any:
    try:
        return yaml.safe_load(read_text(path))
    except (yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error


def _read_map(path: Path) -> dict[str, Any]:
    data = _read_yaml(path)
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path} is damaged: it is not a map")
    return data
