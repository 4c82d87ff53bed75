"""`train_job`: learn a policy, evaluate it, print the results of both."""

from __future__ import annotations

import dataclasses
import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from embodichain.cli.jobs.job import Job
from embodichain.cli.jobs.work.demonstrations import read_dataset
from embodichain.cli.jobs.work.evaluate_job import (
    EvaluationPlan,
    evaluate_job,
    evaluation_config,
    with_suitable_arrays,
)
from embodichain.cli.jobs.work.summary_file import failure_in_summary
from embodichain.cli.results.summaries import training_rows
from embodichain.cli.terminal.output import print_facts, print_json
from embodichain.cli.terminal.process import Interrupted, end_startup

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.learning.evaluation.episodes import TrainStatistics

__all__ = ["train_job"]


def train_job(job: Job) -> float | None:
    """Train, evaluate the policy and print the results of both.

    Returns:
        The objective for a sweeper.
    """
    episodes = job.root.eval.episodes
    seed = job.root.seed
    plan: EvaluationPlan | None = None
    evaluation: Resolved | None = None
    if episodes and seed is not None:  # as `embodichain eval RUN`; checked before training
        plan = EvaluationPlan(episodes, seed)
        evaluation = evaluation_config(job.resolved, plan)
    summary = _read_finished_summary(job) or _learn(job)
    if plan is not None and evaluation is not None and summary["status"] == "finished":
        summary |= _evaluate(job, evaluation, plan)
    if job.root.json:
        print_json(summary)
    elif not job.root.quiet:
        rows = [*training_rows(summary), ("folder", summary["folder"])]
        print_facts(str(summary["task"]), rows)
    return summary["objective"]


def _read_finished_summary(job: Job) -> dict[str, Any] | None:
    """The content of `summary.json` if the job learned to the end before it was started again."""
    from embodichain.cli.sweeps.sweep_jobs import read_summary

    summary = read_summary(job.folder)
    if summary.get("status") != "finished":
        return None
    return {**summary, "folder": str(job.folder)}


def _learn(job: Job) -> dict[str, Any]:
    """Train to the end or until a signal; returns the content of `summary.json`."""
    from embodichain.cli.jobs.work.dashboard import Dashboard
    from embodichain.config.keys.algorithms import DEFAULT_ALGORITHM
    from embodichain.config.run_folder import SUMMARY
    from embodichain.learning.training.train import train

    end_startup()
    root = job.root
    algo = DEFAULT_ALGORITHM if root.algo is None else root.algo.name
    task = job.resolved.task_name
    facts = {"task": task, "algo": algo, "seed": root.seed, "folder": str(job.folder)}
    dashboard = Dashboard(task, algo, root.total_timesteps or 0, quiet=job.quiet)
    with failure_in_summary(job, facts), dashboard as display:

        def progress(statistics: TrainStatistics) -> None:
            job.begin()
            if job.stop.is_stopped():
                raise Interrupted
            if display.due:
                display.update(statistics)

        # Interrupted: checkpoint and summary have been written; the job ends with code 130.
        with suppress(Interrupted):
            results = train(
                job.resolved,
                job.folder,
                progress,
                lambda env: job.attach_viewer(env, realtime=False),
                lambda env: read_dataset(job, env),
                compiled_scene=job.compiled_scene,
            )
            summary = job.resolved.record(dataclasses.asdict(results))
            return {**summary, "folder": str(job.folder)}
    if not (job.folder / SUMMARY).is_file():
        message = f"interrupted ({job.stop.stopped}) before the first update"
        raise Interrupted.by(job.stop.stopped, message)
    summary = json.loads((job.folder / SUMMARY).read_text())
    return {**summary, "folder": str(job.folder)}


def _evaluate(job: Job, resolved: Resolved, plan: EvaluationPlan) -> dict[str, Any]:
    """Evaluate the final checkpoint; returns the summary with the results."""
    from embodichain.config.run_folder import CHECKPOINT
    from embodichain.learning.training.train import add_evaluation

    resolved = resolved.changed(policy=str((job.folder / CHECKPOINT).resolve()))
    resolved = with_suitable_arrays(resolved)
    result = evaluate_job(dataclasses.replace(job, resolved=resolved), plan)
    return add_evaluation(job.folder, result) | job.film(result["log"])
