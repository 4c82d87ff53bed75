"""`evaluate_job`: exactly N episodes of a policy, as `eval` and the end of `train` play them."""

from __future__ import annotations

import dataclasses
import json
import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli.jobs.job import Job, policy_name, policy_of
from embodichain.cli.jobs.receipt import write_receipt
from embodichain.cli.terminal.output import result_number, to_json
from embodichain.cli.terminal.reporting import ProgressDisplay, episodes_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.learning.episode_statistics import EpisodeStatistics

__all__ = [
    "EVAL_FILE",
    "EvaluationPlan",
    "evaluate_job",
    "evaluation_config",
    "objective_of",
    "with_suitable_arrays",
    "write_evaluation_receipt",
]

EVAL_FILE = "eval.json"
"""Name of the results of an evaluation in its folder."""
_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True, slots=True)
class EvaluationPlan:
    """The options of an evaluation.

    Attributes:
        episodes: Number of episodes over all environments.
        seed: As typed; the environments use this plus `EVAL_SEED_OFFSET`.
        deterministic: Whether a trained policy returns its mean action.
    """

    episodes: int
    seed: int
    deterministic: bool = True


def evaluation_config(resolved: Resolved, plan: EvaluationPlan, *, trim: bool = True) -> Resolved:
    """Return the config of an evaluation's environment.

    Args:
        resolved: The config of the run to evaluate.
        plan: The options of the evaluation.
        trim: Whether to reduce the number of environments to the number of episodes.

    Raises:
        ConfigError: The log is configured to show environments that the evaluation does not have.
    """
    from embodichain.learning.evaluation.evaluation import EVAL_SEED_OFFSET

    num_envs = int(resolved.tree["num_envs"])
    if trim:
        num_envs = min(num_envs, plan.episodes)
    record = resolved.root.record
    missing_envs = [i for i in record.view_envs if i >= num_envs]
    if missing_envs and record.format != "none":
        message = f"no such environments: {missing_envs}; the evaluation has {num_envs}"
        raise ConfigError([Problem("record.view_envs", message)])
    episodes = math.ceil(plan.episodes / num_envs)
    seed = EVAL_SEED_OFFSET + plan.seed
    return resolved.changed(num_envs=num_envs, episodes=episodes, seed=seed)


def with_suitable_arrays(resolved: Resolved) -> Resolved:
    """Return the config with arrays on the host where an evaluation needs them there.

    Args:
        resolved: A config of `evaluation_config` that names the policy.
    """
    from embodichain.config.environments.host_arrays import why_host, with_arrays

    reasons = why_host(resolved.root, "run")
    if not reasons or resolved.root.sim.warp.arrays != "device":
        return resolved
    _log.warning("the evaluation has arrays on the host, because %s", "; ".join(reasons))
    return with_arrays(resolved, "host")


def evaluate_job(job: Job, plan: EvaluationPlan) -> dict[str, Any]:
    """Build, roll out, log, and write `eval.json` into the run's folder.

    Args:
        job: A job with a config of `evaluation_config` that names the policy. If a signal stops
            it, the episodes until then count.
        plan: The options of the evaluation.

    Returns:
        The content of `eval.json`.
    """
    from embodichain.config.environments.factory import make_batch
    from embodichain.learning.evaluation.evaluation import evaluate, quotas

    task = job.resolved.task_name
    env = make_batch(job.resolved, compiled_scene=job.compiled_scene, run_dir=job.folder)
    try:
        policy = policy_of(job.root, env, deterministic=plan.deterministic)
        quota = quotas(plan.episodes, env.num_envs).tolist()
        recorder = job.attach_log(env, quota=quota)
        job.attach_viewer(env, realtime=False, resets=False)
        job.begin()
        unit = episodes_of(env.num_envs)
        with ProgressDisplay(task, plan.episodes, unit, quiet=job.quiet) as display:

            def watch(counted: EpisodeStatistics) -> bool:
                if display.due or counted.complete:
                    display.show(counted.episodes, _facts(counted))
                return job.stop.is_stopped()

            evaluation = evaluate(env, policy, plan.episodes, seed=plan.seed, watch=watch)
    finally:
        env.close()  # finishes the log too
    result = {
        "task": task,
        "policy": job.root.policy,
        "deterministic": plan.deterministic,
        "folder": str(job.folder),
        "log": None if recorder is None else str(recorder.stats.path),
        "changed": [str(change) for change in getattr(policy, "changed", ())],
        **evaluation.as_dict(),
    }
    if recorder is not None:
        drawn = _drawn_in(recorder.stats.path, evaluation.per_episode["env"])
        if drawn:
            result["per_episode"]["drawn"] = drawn
    text = to_json(job.resolved.record(result), indent=2)
    write_text(job.folder / EVAL_FILE, text + "\n")
    return result


def write_evaluation_receipt(job: Job, plan: EvaluationPlan, result: Mapping[str, Any]) -> Path:
    """Write `receipt.json` of a finished evaluation into its folder.

    Args:
        job: The job of the evaluation.
        plan: The options of the evaluation.
        result: What `evaluate_job` has returned.

    Returns:
        The receipt.
    """
    policy = job.root.policy
    file = Path(policy) if isinstance(policy, str) and Path(policy).is_file() else None
    results = {name: result[name] for name in ("success", "returns", "length", "confidence")}
    facts = {
        "task": result["task"],
        "policy": policy_name(job.root),
        "seed": plan.seed,
        "deterministic": plan.deterministic,
        "num_envs": result["num_envs"],
        "episodes": result["episodes"],
        "results": json.loads(to_json(results)),
    }
    logs = [] if result["log"] is None else [Path(result["log"])]
    # A log may have several parts, or one for each shard.
    parts = sorted([*job.folder.glob("rollout*.mcap"), *job.folder.glob("rollout*.json")])
    return write_receipt(
        job.folder,
        "eval",
        facts,
        files=[job.folder / EVAL_FILE, *(parts if logs else [])],
        logs=logs,
        policy=file,
    )


def _drawn_in(log: Path, envs: Sequence[int]) -> dict[str, list[list[float] | None]]:
    """What was drawn for the counted episodes of a log, of which the environments are given.

    Returns:
        ``TERM.NAME`` -> its numbers in each of the episodes, None where it was not drawn.
    """
    from embodichain import recording

    drawn: dict[int, list[Mapping[str, list[float]]]] = {}  # by environment, in time
    for episode in sorted(recording.inspect(log).episodes, key=lambda episode: episode.episode):
        if episode.counted:
            drawn.setdefault(episode.env, []).append(episode.drawn)
    rows: list[Mapping[str, list[float]]] = []
    for env in envs:
        rows.append(drawn[env].pop(0) if drawn.get(env) else {})
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def _facts(counted: EpisodeStatistics) -> dict[str, str]:
    """The numbers shown beside the progress bar."""
    facts = {"step": str(counted.steps)}
    mean_return = counted.mean("return")
    success = counted.mean("success")
    if mean_return is not None:
        facts["return"] = result_number(mean_return)
    if success is not None:
        facts["success"] = f"{success:.0%}"
    return facts


def objective_of(result: Mapping[str, Any]) -> float | None:
    """Return the objective for a sweeper: the success rate, else the mean return."""
    if result["success"] is not None:
        return float(result["success"]["rate"])
    if result["returns"] is not None:
        return float(result["returns"]["mean"])
    return None
