"""`embodichain replay FILE --policy P`: repeats the recorded episodes with another policy.

The config is read from the log, and no module that it names is imported. Seeds and environments are
the same, so every episode begins in the recorded state.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.cli.jobs.job import policy_of
from embodichain.cli.jobs.trained import find_target
from embodichain.cli.terminal import process
from embodichain.cli.terminal.output import (
    print_facts,
    print_json,
    print_table,
    result_row,
    say_warnings,
)
from embodichain.cli.terminal.reporting import ProgressDisplay
from embodichain.lab.gym.envs.cfg import NO_LIMIT
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.policies import Policy
    from embodichain.recording.read.api import Log
    from embodichain.recording.read.episodes import LogEpisode

__all__ = ["Repetition", "rerun"]

_MAX_LENGTH_RATIO = 10
"""Without a time limit, episodes end after this multiple of the longest recorded one."""
_MOST_ROWS = 20
_ROUNDING = 1e-5
"""Largest difference of first states where the recorded ones were computed in float32."""
_STATE = ("qpos", "qvel", "mocap_pos", "mocap_quat")


@dataclass(frozen=True, slots=True)
class _Pair:
    """One episode as recorded, and with the policy; its fields are what is printed.

    Attributes:
        env: The environment.
        episode: Number of the episode in its environment.
        recorded_steps: Control steps as recorded.
        steps: Control steps with the policy.
        recorded_return: Return as recorded.
        total_return: Return with the policy.
        difference: Return with the policy minus that as recorded.
        cut: Whether the log ends before the episode: both cover its first steps only.
    """

    env: int
    episode: int
    recorded_steps: int
    steps: int
    recorded_return: float
    total_return: float
    difference: float
    cut: bool


@dataclass(frozen=True, slots=True)
class Repetition:
    """What is repeated, and by which policy.

    Attributes:
        policy: A training's folder, a file, or the policy's name.
        env: Only this environment.
        episode: Only this episode of each environment.
        allow_changed: Whether the policy may be trained in another task.
        trust: Whether code of the policy's file may run.
    """

    policy: str
    env: int | None = None
    episode: int | None = None
    allow_changed: bool = False
    trust: bool = False


@dataclass(frozen=True, slots=True)
class _FirstStates:
    """The first recorded state of each environment.

    Attributes:
        columns: Component of the state -> (N, W) values.
        tolerance: By how much a component may differ from them.
    """

    columns: dict[str, NDArray[np.float64]]
    tolerance: float

    @classmethod
    def of_log(cls, log: Log) -> _FirstStates:
        """Read them from a log."""
        names = [name for name in _STATE if name in log.columns]
        columns = {name: log.read(name, start=0, stop=1)[name][0] for name in names}
        tolerance = 0.0 if log.header.has_writes else _ROUNDING
        return cls(columns, tolerance)

    def match(self, env: BaseEnv) -> bool:
        """Whether an environment that was just reset has these states."""
        state = env.sim.engine.state
        return all(
            np.allclose(state(name), values, rtol=0.0, atol=self.tolerance)
            for name, values in self.columns.items()
        )


def rerun(path: Path, repetition: Repetition, *, quiet: bool = False, json: bool = False) -> int:
    """Repeat recorded episodes with another policy, and compare returns.

    Args:
        path: The log.
        repetition: What is repeated, and by which policy.
        quiet: Print nothing.
        json: Print one JSON object.

    Returns:
        The exit code.

    Raises:
        ConfigError: The log has no such episode, or the policy cannot act in its task.
    """
    from embodichain.config.environments.factory import make_env
    from embodichain.data.pretrained import pretrained
    from embodichain.lab.gym.policies import PRETRAINED
    from embodichain.recording.demos.reenactment import config_of
    from embodichain.recording.shards import joining

    target = find_target(repetition.policy)
    with joining.open(path) as log:
        episodes = _chosen_episodes(log, repetition)
        resolved = config_of(log)
        first_states = _FirstStates.of_log(log)
        warnings = list(log.warnings)
    policy_name = target.policy
    if policy_name == PRETRAINED:
        policy_name = str(pretrained(resolved.task_name).file)
    env = make_env(resolved)
    try:
        root = resolved.changed(allow_changed=repetition.allow_changed, trust=repetition.trust).root
        policy = policy_of(root, env, policy_name)
        obs, _ = env.reset()
        same_start = first_states.match(env)
        with ProgressDisplay("replay", len(episodes), "episodes", quiet=quiet or json) as display:
            pairs = _play(env, policy, obs, episodes=episodes, display=display)
    finally:
        env.close()
    if not same_start:
        warnings.append("the first states differ from the recorded ones: other code, or MuJoCo")
    say_warnings(path, warnings)
    facts = {
        "task": resolved.task_name,
        "policy": target.policy,
        "episodes": len(pairs),
        "recorded_mean_return": float(np.mean([pair.recorded_return for pair in pairs])),
        "mean_return": float(np.mean([pair.total_return for pair in pairs])),
        "same_start": same_start,
    }
    if json:
        print_json({**facts, "pairs": [asdict(pair) for pair in pairs]})
    elif not quiet:
        print_table("episodes", [result_row(asdict(pair)) for pair in pairs[:_MOST_ROWS]])
        if len(pairs) > _MOST_ROWS:
            sys.stdout.write(f"... and {len(pairs) - _MOST_ROWS} more: --env, --json\n")
        rows = result_row(facts).items()
        print_facts(str(path), [(name.replace("_", " "), value) for name, value in rows])
    return process.OK


def _chosen_episodes(log: Log, repetition: Repetition) -> dict[tuple[int, int], LogEpisode]:
    """The log's episodes that are repeated, by environment and number.

    Raises:
        ConfigError: There is none, or the log began in the middle of a run.
    """
    episodes: dict[tuple[int, int], LogEpisode] = {}
    for episode in log.episodes:
        if episode.first_step == log.header.first_step and episode.episode > 0:
            # The draws of earlier episodes are not in the log.
            message = "does not begin with first episodes: their seeds lead to other states"
            raise ConfigError(f"{log.path} {message}")
        is_env = repetition.env in (None, episode.env)
        is_episode = repetition.episode in (None, episode.episode)
        if is_env and is_episode:
            episodes[episode.env, episode.episode] = episode
    if not episodes:
        raise ConfigError(f"{log.path} has no such episode: there is nothing to compare")
    return episodes


def _play(
    env: BaseEnv,
    policy: Policy,
    obs: Any,
    *,
    episodes: dict[tuple[int, int], LogEpisode],
    display: ProgressDisplay,
) -> list[_Pair]:
    """Play until each of the episodes has its pair.

    Args:
        env: The environment, just reset.
        policy: The policy.
        obs: Its first observation.
        episodes: The recorded episodes that are repeated.
        display: Shows how many are done.
    """
    returns = np.zeros(env.num_envs)
    steps = np.zeros(env.num_envs, np.int64)
    pairs: dict[tuple[int, int], _Pair] = {}
    # The log ends before these did: they are compared over their recorded steps.
    cut_episodes = [key for key, episode in episodes.items() if _is_cut(episode)]
    limit = NO_LIMIT
    if env.max_episode_steps == NO_LIMIT:  # episodes of another policy might never end
        limit = _MAX_LENGTH_RATIO * max(episode.steps for episode in episodes.values())
    while len(pairs) < len(episodes):
        ids = env.episode_ids.numpy()
        obs, reward, terminated, truncated, _ = env.step(policy(obs, env))
        returns += reward.numpy(force=True)
        steps += 1
        if (steps >= limit).any():
            env.truncate(np.flatnonzero(steps >= limit))
        done = np.flatnonzero((terminated | truncated).numpy(force=True))
        ended = [(i, int(ids[i])) for i in done.tolist()]
        ended += [
            (i, episode)
            for i, episode in cut_episodes
            if episode == ids[i] and steps[i] == episodes[i, episode].steps
        ]
        for key in ended:
            # An episode is compared where it ends first: as recorded, or with the policy.
            if key in episodes and key not in pairs:
                i = key[0]
                pairs[key] = _pair(episodes[key], int(steps[i]), float(returns[i]))
        if len(done):
            returns[done] = 0.0
            steps[done] = 0
            policy.reset(done)
        if display.due:
            display.show(len(pairs), {})
    return [pairs[key] for key in sorted(pairs)]


def _is_cut(episode: LogEpisode) -> bool:
    """Whether the log ends before an episode does."""
    return not (episode.terminated or episode.truncated)


def _pair(recorded: LogEpisode, steps: int, total_return: float) -> _Pair:
    return _Pair(
        env=recorded.env,
        episode=recorded.episode,
        recorded_steps=recorded.steps,
        steps=steps,
        recorded_return=recorded.total_reward,
        total_return=total_return,
        difference=total_return - recorded.total_reward,
        cut=_is_cut(recorded),
    )
