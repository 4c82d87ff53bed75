"""`embodichain replay FILE --policy P`: repeats the recorded episodes with another policy.

The config is read from the log, and no module that it names is imported. Seeds and environments are
the same, so every episode begins in the recorded state.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.cli.jobs.job import policy_of
from embodichain.cli.jobs.trained import find_target
from embodichain.cli.terminal import process
from embodichain.cli.terminal.output import print_facts, print_json, print_table, say_warnings
from embodichain.cli.terminal.reporting import ProgressDisplay
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.recording.read.api import Log
    from embodichain.recording.read.episodes import LogEpisode

__all__ = ["rerun"]

_LONGER = 10
_NEVER = 2**31 - 1
_MOST_ROWS = 20
_ROUNDING = 1e-5
"""Largest difference of first states where the recorded ones were computed in float32."""
_STATE = ("qpos", "qvel", "mocap_pos", "mocap_quat")


@dataclass(frozen=True, slots=True)
class _Pair:
    """One episode as recorded, and with the policy."""

    env: int
    episode: int
    recorded_steps: int
    steps: int
    recorded_return: float
    total_return: float
    difference: float
    cut: bool  # the log ends before the episode: both cover its first steps only


def rerun(path: Path, options: SimpleNamespace) -> int:
    """Repeat recorded episodes with another policy, and compare returns."""
    from embodichain.config.environments.factory import make_env
    from embodichain.data.pretrained import pretrained
    from embodichain.lab.gym.policies import PRETRAINED
    from embodichain.recording.demos.reenactment import config_of
    from embodichain.recording.shards import joining

    target = find_target(options.policy)
    with joining.open(path) as log:
        wanted = _wanted(log, options)
        resolved = config_of(log)
        rounding = 0.0 if log.header.has_writes else _ROUNDING
        names = [name for name in _STATE if name in log.columns]
        starts = {name: log.read(name, start=0, stop=1)[name][0] for name in names}
        warnings = list(log.warnings)
    policy = target.policy
    if policy == PRETRAINED:
        policy = str(pretrained(resolved.task_name).file)
    env = make_env(resolved)
    try:
        pairs, same = _play(env, policy, resolved, wanted, (starts, rounding), options)
    finally:
        env.close()
    if not same:
        warnings.append("the first states differ from the recorded ones: other code, or MuJoCo")
    say_warnings(path, warnings)
    facts = {
        "task": resolved.task_name,
        "policy": target.policy,
        "episodes": len(pairs),
        "recorded_mean_return": float(np.mean([p.recorded_return for p in pairs])),
        "mean_return": float(np.mean([p.total_return for p in pairs])),
        "same_start": same,
    }
    if options.json:
        print_json({**facts, "pairs": [asdict(pair) for pair in pairs]})
    elif not options.quiet:
        print_table("episodes", [asdict(pair) for pair in pairs[:_MOST_ROWS]])
        if len(pairs) > _MOST_ROWS:
            sys.stdout.write(f"... and {len(pairs) - _MOST_ROWS} more: --env, --json\n")
        print_facts(str(path), [(name.replace("_", " "), value) for name, value in facts.items()])
    return process.OK


def _wanted(log: Log, options: SimpleNamespace) -> dict[tuple[int, int], LogEpisode]:
    """The log's episodes that the options select."""
    if any(e.episode for e in log.episodes if e.first_step == log.header.first_step):
        raise ConfigError(f"{log.path} does not begin with first episodes: seeds lead elsewhere")
    found = {
        (e.env, e.episode): e
        for e in log.episodes
        if options.env in (None, e.env) and options.episode in (None, e.episode)
    }
    if not found:
        raise ConfigError(f"{log.path} has no such episode: there is nothing to compare")
    return found


def _play(
    env: BaseEnv,
    policy_name: str,
    resolved: Resolved,
    wanted: dict[tuple[int, int], LogEpisode],
    recorded: tuple[dict[str, NDArray[np.float64]], float],
    options: SimpleNamespace,
) -> tuple[list[_Pair], bool]:
    """The episodes, and whether all environments began in the recorded state.

    Args:
        env: The environment.
        policy_name: The policy.
        resolved: The config of the log.
        wanted: The episodes that are repeated.
        recorded: Components of the first states, and by how much they may differ.
        options: Those of the command line.
    """
    starts, rounding = recorded
    allowed = resolved.changed(allow_changed=bool(options.allow_changed), trust=bool(options.trust))
    policy = policy_of(allowed.root, env, policy_name)
    obs, _ = env.reset()
    state = env.sim.engine.state
    same = all(
        np.allclose(state(name), values, rtol=0.0, atol=rounding) for name, values in starts.items()
    )
    returns, steps = np.zeros(env.num_envs), np.zeros(env.num_envs, np.int64)
    pairs: dict[tuple[int, int], _Pair] = {}
    cut = {key for key, e in wanted.items() if not (e.terminated or e.truncated)}
    # Without a time limit in the task, episodes of another policy might never end.
    longest = max(e.steps for e in wanted.values())
    limit = _LONGER * longest if env.max_episode_steps == _NEVER else _NEVER
    quiet = options.quiet or options.json
    with ProgressDisplay("replay", len(wanted), "episodes", quiet=quiet) as display:
        while len(pairs) < len(wanted):
            ids = env.episode_ids.numpy()
            obs, reward, terminated, truncated, _ = env.step(policy(obs, env))
            returns += reward.numpy(force=True)
            steps += 1
            if (steps >= limit).any():
                env.truncate(np.flatnonzero(steps >= limit))
            done = np.flatnonzero((terminated | truncated).numpy(force=True))
            ended = [k for k in cut if k[1] == ids[k[0]] and steps[k[0]] == wanted[k].steps]
            ended += [key for i in done.tolist() if (key := (i, int(ids[i]))) in wanted]
            for key in ended:
                cut.discard(key)
                pairs.setdefault(key, _pair(wanted[key], int(steps[key[0]]), returns[key[0]]))
            if len(done):
                returns[done], steps[done] = 0.0, 0
                policy.reset(done)
            if display.due:
                display.show(len(pairs), {})
    return [pairs[key] for key in sorted(pairs)], same


def _pair(recorded: LogEpisode, steps: int, total: float) -> _Pair:
    return _Pair(
        env=recorded.env,
        episode=recorded.episode,
        recorded_steps=recorded.steps,
        steps=steps,
        recorded_return=recorded.total_reward,
        total_return=float(total),
        difference=float(total) - recorded.total_reward,
        cut=not (recorded.terminated or recorded.truncated),
    )
