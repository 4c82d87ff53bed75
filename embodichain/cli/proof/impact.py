"""What a change does to recorded episodes: another MuJoCo, another model, another YAML.

Each log is played again with its recorded actions in the task as it is today, and every state is
compared with the recorded one, to the bit. An environment *parts* at the first control step where
they differ; from there on its actions meet other states, so later differences follow from the
first.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import yaml
from numpy.typing import NDArray

from embodichain.config.composition.composed import compose, list_options
from embodichain.config.resolved import Resolved, resolve_tree
from embodichain.learning.episode_statistics import EpisodeStatistics, play
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.types import EnvObs
    from embodichain.recording.read.api import Log

__all__ = ["Impact", "as_row", "impact_elsewhere", "impact_of", "impacts_of"]

_STATE = ("qpos", "qvel", "mocap_pos", "mocap_quat")
_CONFIG_KEYS = ("task", "embodiment", "variation", "sim", "device", "gym_config")
"""Roots of recorded overrides that say which task is played."""


@dataclass(frozen=True)
class Impact:
    """What a change does to the episodes of one log.

    Attributes:
        log: The log.
        task: Its task.
        envs: Number of environments.
        steps: Control steps that were played again.
        parted: Number of environments whose states differ from the recorded ones.
        first_step: The first control step with another state; None if there is none.
        first_env: The environment that parts there.
        component: The component of the state that differs most there, such as ``qpos``.
        first_difference: Its largest difference there, in its own unit (m, rad, m/s, rad/s).
        largest_difference: The largest difference of a position (m or rad) in any step.
        episodes: Number of episodes that ended in both.
        successes_before: Recorded successes among them.
        successes: Successes now.
        flips: Episodes whose success is another one.
        reason: Why the log could not be played; empty if it was.
        notes: What a reader should know: a config that is not today's.
    """

    log: str
    task: str
    envs: int
    steps: int = 0
    parted: int = 0
    first_step: int | None = None
    first_env: int | None = None
    component: str = ""
    first_difference: float = 0.0
    largest_difference: float = 0.0
    episodes: int = 0
    successes_before: int = 0
    successes: int = 0
    flips: int = 0
    reason: str = ""
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing differs."""
        return not self.parted and not self.flips and not self.reason


def impact_of(path: Path, overrides: Sequence[str] = (), *, trust: bool = False) -> Impact:
    """Play a log again in its task as it is today, and compare.

    The config is composed from today's files, with those of the recorded overrides that are about
    the task.

    Args:
        path: The log.
        overrides: Changes to the config, in Hydra's grammar.
        trust: Whether modules that the config names are imported. A log chooses the task and has
            overrides, so by default none is.

    Raises:
        ConfigError: The log cannot be read, or the config has mistakes.
    """
    from embodichain.config.environments.factory import make_env
    from embodichain.recording.shards import joining

    with joining.open(path) as log:
        resolved, notes = _config(log, overrides, trust=trust)
        recorded = _Recorded(log)
        impact = Impact(str(path), log.task, log.num_envs, notes=tuple(notes))
        env = make_env(resolved)
        try:
            reason = recorded.why_incomparable(env)
            if reason:
                return replace(impact, reason=reason, parted=log.num_envs)
            counted = EpisodeStatistics(env.num_envs, len(recorded.actions) + 1)
            obs, _ = env.reset()
            with torch.no_grad():
                for _ in play(env, recorded, obs, counted):
                    if recorded.step == len(recorded.actions):
                        break
        finally:
            env.close()
        return _summarize(impact, recorded, log, counted)


def impacts_of(
    paths: Sequence[Path], overrides: Sequence[str] = (), *, trust: bool = False
) -> list[Impact]:
    """Play logs again, see `impact_of`. One that cannot be played does not end the others.

    Args:
        paths: The logs.
        overrides: As of `impact_of`.
        trust: As of `impact_of`.

    Raises:
        ConfigError: No log can be played.
    """
    impacts: list[Impact] = []
    errors: list[ConfigError] = []
    for path in paths:
        try:
            impacts.append(impact_of(path, overrides, trust=trust))
        except ConfigError as error:
            reason = " ".join(str(error).split())
            impacts.append(Impact(str(path), task="", envs=0, reason=reason))
            errors.append(error)
    if len(errors) == len(paths):
        raise errors[0]
    return impacts


def impact_elsewhere(
    python: Path, logs: Sequence[Path], overrides: Sequence[str], *, trust: bool = False
) -> list[dict[str, Any]]:
    """Have another interpreter, with its own MuJoCo, play logs again.

    Args:
        python: The interpreter, or the folder of its virtual environment.
        logs: The logs.
        overrides: Changes to the config.
        trust: As in `impact_of`.

    Returns:
        The fields of an `Impact` for each log.

    Raises:
        ConfigError: There is no such interpreter, or it cannot play the logs.
    """
    executable = python
    if python.is_dir():
        executable = python / "bin" / "python"
    if not executable.is_file():
        raise ConfigError(f"--with-python: there is no interpreter {executable}")
    words = [str(log.resolve()) for log in logs]
    command = [str(executable), "-m", "embodichain", "impact", *words, *overrides, "--json"]
    if trust:
        command.append("--trust")
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode not in (0, 1):
        raise ConfigError(f"{executable} cannot play the logs: {result.stderr.strip()}")
    try:
        impacts: list[dict[str, Any]] = json.loads(result.stdout)["logs"]
    except (ValueError, KeyError) as error:
        text = result.stderr.strip() or result.stdout.strip()
        raise ConfigError(f"{executable} cannot play the logs: {text}") from error
    return impacts


def _config(log: Log, overrides: Sequence[str], *, trust: bool) -> tuple[Resolved, list[str]]:
    """The config in which a log is played again, and notes."""
    typed = [str(line) for line in yaml.safe_load(log.attachment("overrides.yaml")) or []]
    lines = [line for line in typed if _root_of(line) in _CONFIG_KEYS]
    notes: list[str] = []
    if not any(line.startswith(("task=", "gym_config=")) for line in lines):
        if log.task not in list_options("task"):
            raise ConfigError(f"{log.path}: there is no task {log.task!r} any more")
        lines.insert(0, f"task={log.task}")
        notes.append(f"the log's overrides name no task: it is played in {log.task} as it is now")
    composed = compose([*lines, *overrides], "run")
    if composed.problems:
        raise ConfigError(composed.problems)
    resolved = resolve_tree(
        composed.tree, composed.source, "run", task_name=log.task, allow_import=trust
    )
    return resolved.changed(
        seed=log.seed,
        num_envs=log.num_envs,
        policy=None,
        quiet=True,
        viewer={"name": "none"},
        record={"format": "none"},
    ), notes


def _root_of(override: str) -> str:
    """The first word of an override's key."""
    key = override.lstrip("+~").partition("=")[0]
    return key.partition(".")[0].partition("@")[0].partition("/")[0]


class _Recorded:
    """A policy that plays recorded actions, and compares the states that they meet.

    Args:
        log: The log.

    Attributes:
        actions: (T, N, A) recorded actions.
        step: Number of actions played.
        parted_at: (N,) the control step at which each environment parted; T if it did not.
        first: Component and difference at the first of them.
        largest: The largest difference of a position.
    """

    def __init__(self, log: Log) -> None:
        names = [name for name in _STATE if name in log.columns]
        fields = log.read(["actions", *names])
        self.actions: NDArray[np.float64] = fields["actions"]
        self._states = {name: fields[name] for name in names}
        self.step = 0
        self.parted_at = np.full(log.num_envs, len(self.actions))
        self.first: tuple[str, float] = ("", 0.0)
        self.largest = 0.0

    def why_incomparable(self, env: BaseEnv) -> str:
        """Why an environment has other actions or states; empty if it has the same."""
        num_actions = int(np.prod(env.single_action_space.shape or ()))
        if num_actions != self.actions.shape[2]:
            return f"{num_actions} columns of actions, {self.actions.shape[2]} recorded"
        for name, values in self._states.items():
            width = env.sim.engine.state(name).shape[1]
            if width != values.shape[2]:
                return f"another scene: {width} numbers of {name}, {values.shape[2]} recorded"
        return ""

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        """Compare the states, and return the next recorded actions."""
        self._compare(env)
        action = self.actions[self.step]
        self.step += 1
        return torch.as_tensor(action, dtype=torch.float32)

    def reset(self, env_ids: NDArray[np.int64] | None) -> None:
        """Do nothing: actions go on as they were recorded."""

    def _compare(self, env: BaseEnv) -> None:
        is_first = bool((self.parted_at == len(self.actions)).all())
        for name, values in self._states.items():
            state = np.asarray(env.sim.engine.state(name))
            difference = np.abs(state - values[self.step]).reshape(env.num_envs, -1)
            by_env = difference.max(axis=1, initial=0.0)
            self.parted_at[(by_env > 0) & (self.parted_at > self.step)] = self.step
            largest = float(by_env.max())
            if is_first and largest > self.first[1]:
                self.first = (name, largest)
            if name in ("qpos", "mocap_pos"):
                self.largest = max(self.largest, largest)


def _summarize(impact: Impact, recorded: _Recorded, log: Log, counted: EpisodeStatistics) -> Impact:
    steps = len(recorded.actions)
    has_parted = recorded.parted_at < steps
    before = {
        (episode.env, episode.episode): episode.success
        for episode in log.episodes
        if episode.terminated or episode.truncated
    }
    now: dict[tuple[int, int], bool | None] = {}
    if "success" in counted.names():
        columns = (counted.column(name) for name in ("env", "episode", "success"))
        for env, episode, success in zip(*columns, strict=True):
            now[int(env), int(episode)] = bool(success)
    common = [key for key in before if key in now and before[key] is not None]
    first_env = int(recorded.parted_at.argmin()) if has_parted.any() else None
    component, difference = recorded.first
    return replace(
        impact,
        steps=steps,
        parted=int(has_parted.sum()),
        first_step=None if first_env is None else int(recorded.parted_at[first_env]),
        first_env=first_env,
        component=component,
        first_difference=difference,
        largest_difference=recorded.largest,
        episodes=len(common),
        successes_before=sum(before[key] is True for key in common),
        successes=sum(now[key] is True for key in common),
        flips=sum(before[key] is not now[key] for key in common),
    )


def as_row(impact: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a log for a table of text."""
    row = {
        "log": impact["log"],
        "task": impact["task"],
        "parted": f"{impact['parted']} of {impact['envs']}",
        "first step": "-",
        "by": "-",
        "largest": "-",
        "successes": f"{impact['successes_before']} -> {impact['successes']}",
        "flips": impact["flips"],
    }
    if impact["reason"]:
        if not impact["envs"]:  # it could not be played at all
            row |= {"parted": "-", "successes": "-", "flips": "-"}
        row["by"] = impact["reason"]
    elif impact["first_step"] is not None:
        row["first step"] = f"{impact['first_step']} (environment {impact['first_env']})"
        row["by"] = f"{impact['component']} {impact['first_difference']:.2g}"
        row["largest"] = f"{impact['largest_difference']:.2g}"
    return row
