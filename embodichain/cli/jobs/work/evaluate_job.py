"""`evaluate_job`: exactly N episodes of a policy, as `eval` and the end of `train` play them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from embodichain.cli.jobs.job import Job, policy_of
from embodichain.cli.terminal.output import to_json
from embodichain.cli.terminal.reporting import ProgressDisplay, episodes_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.learning.episode_statistics import EpisodeStatistics

__all__ = ["EvaluationPlan", "evaluate_job", "evaluation_config", "objective_of"]

EVAL_FILE = "eval.json"


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

    count = int(resolved.tree["num_envs"])
    if trim:
        count = min(count, plan.episodes)
    record = resolved.root.record
    beyond = [i for i in record.view_envs if i >= count]
    if beyond and record.format != "none":
        message = f"no such environments: {beyond}; the evaluation has {count}"
        raise ConfigError([Problem("record.view_envs", message)])
    episodes = -(-plan.episodes // count)
    return resolved.changed(num_envs=count, episodes=episodes, seed=EVAL_SEED_OFFSET + plan.seed)


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
        "log": str(recorder.stats.path) if recorder is not None else None,
        "changed": [str(change) for change in getattr(policy, "changed", ())],
        **evaluation.as_dict(),
    }
    text = to_json(job.resolved.record(result), indent=2)
    write_text(job.folder / EVAL_FILE, text + "\n")
    return result


def _facts(counted: EpisodeStatistics) -> dict[str, str]:
    facts = {"step": f"{counted.steps}"}
    for name, form in (("return", ".3g"), ("success", ".0%")):
        mean = counted.mean(name)
        if mean is not None:
            facts[name] = format(mean, form)
    return facts


def objective_of(result: Mapping[str, Any]) -> float | None:
    """Return the objective for a sweeper: the success rate, else the mean return."""
    if result["success"] is not None:
        return float(result["success"]["rate"])
    return None if result["returns"] is None else float(result["returns"]["mean"])
