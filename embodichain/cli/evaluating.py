"""Playing a policy for an evaluation: what `eval` and the end of `train` share.

Counting is `embodichain.learning.evaluation`'s, showing what came out `evaluated.py`'s.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.cli.jobs import Job
    from embodichain.cli.stopping import StopFlag
    from embodichain.config.resolved import Resolved
    from embodichain.learning.episode_statistics import EpisodeStatistics
    from embodichain.learning.evaluation import Evaluation

__all__ = ["EVAL_FILE", "Asked", "evaluate_job", "evaluation_config"]

EVAL_FILE = "eval.json"


@dataclasses.dataclass(frozen=True, slots=True)
class Asked:
    """What is evaluated.

    Attributes:
        episodes: How many, over all environments.
        seed: As people give it; that of the environments is `EVAL_SEED_OFFSET` higher.
        deterministic: Whether a trained policy takes its mean action.
    """

    episodes: int
    seed: int
    deterministic: bool = True


def evaluation_config(resolved: Resolved, asked: Asked, *, trim: bool = True) -> Resolved:
    """Return the config that an evaluation's environment is built with, as it is written.

    Args:
        resolved: Of what is evaluated.
        asked: How.
        trim: Whether there are at most as many environments as episodes: more would play for
            nothing.

    Raises:
        ConfigError: The log would show environments that the evaluation does not have.
    """
    from embodichain.config.frozen import freeze
    from embodichain.learning.evaluation import EVAL_SEED_OFFSET

    tree = dict(resolved.tree)
    if trim:
        tree["num_envs"] = min(tree["num_envs"], asked.episodes)
    record = resolved.root.record
    beyond = [i for i in record.view_envs if i >= tree["num_envs"]]
    if beyond and record.format != "none":
        message = f"no such environments: {beyond}; the evaluation has {tree['num_envs']}"
        raise ConfigError([Problem("record.view_envs", message)])
    tree["episodes"] = -(-asked.episodes // tree["num_envs"])
    tree["seed"] = EVAL_SEED_OFFSET + asked.seed
    return dataclasses.replace(resolved, tree=freeze(tree))


def evaluate_job(run: Job, stop: StopFlag, asked: Asked) -> dict[str, Any]:
    """Build, play, log, and write `eval.json` into the run's folder.

    Args:
        run: Its config is one of `evaluation_config`, with the policy to play.
        stop: Its flag ends the evaluation after a whole step: what was played until then counts.
        asked: How.

    Returns:
        What `eval.json` holds.
    """
    from embodichain.cli.arguments import to_json
    from embodichain.config.run_folder import write_atomically

    found, log, changed = _play(run, stop, asked)
    result = {
        "task": run.resolved.task_name,
        "policy": run.root.policy,
        "deterministic": asked.deterministic,
        "folder": str(run.folder),
        "log": log,
        "changed": changed,
        **found.as_dict(),
    }
    write_atomically(run.folder / EVAL_FILE, to_json(result, indent=2) + "\n")
    return result


def _play(run: Job, stop: StopFlag, asked: Asked) -> tuple[Evaluation, str | None, list[str]]:
    """The evaluation from build to close, where its log is, and what changed since training."""
    from embodichain.cli.attach import attach_log
    from embodichain.cli.policies import policy_of
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.cli.viewing import attach_viewer
    from embodichain.config.factory import make_env
    from embodichain.learning.evaluation import evaluate

    root, task = run.root, run.resolved.task_name
    env = make_env(run.resolved, run_dir=run.folder)
    try:
        policy = policy_of(root, env, deterministic=asked.deterministic)
        recorder = attach_log(run, env)
        attach_viewer(root, env, stop, realtime=False, resets=False)
        quiet = root.quiet or root.json
        with ProgressDisplay(task, asked.episodes, "episodes", quiet=quiet) as display:

            def watch(counted: EpisodeStatistics) -> bool:
                if display.due or counted.complete:
                    display.show(counted.episodes, _facts(counted))
                return stop.stopped is not None

            found = evaluate(env, policy, asked.episodes, seed=asked.seed, watch=watch)
    finally:
        env.close()  # finishes the log too
    changed = [str(change) for change in getattr(policy, "changed", ())]
    return found, str(recorder.stats.path) if recorder is not None else None, changed


def _facts(counted: EpisodeStatistics) -> dict[str, str]:
    facts = {"step": f"{counted.steps}"}
    for name, form in (("return", ".3g"), ("success", ".0%")):
        mean = counted.mean(name)
        if mean is not None:
            facts[name] = format(mean, form)
    return facts
