"""`embodichain train`: learn a policy with Stable-Baselines3, or resume a training.

``resume=RUN`` reads the config from the run's `config.yaml`. It is the same experiment, so only few
keys may change. It continues in a new folder; the files of the earlier run are not changed.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from embodichain.cli.app import command_line, job_arguments, verb
from embodichain.cli.jobs.demonstrations import read_dataset
from embodichain.cli.jobs.job import Job, execute, start
from embodichain.cli.jobs.resuming import parsed_changes, resumed_folder, resumption, with_changes
from embodichain.cli.results.summaries import training_rows
from embodichain.cli.terminal.output import print_facts, print_json, to_json
from embodichain.cli.terminal.process import Interrupted, started
from embodichain.cli.verbs.eval import Asked, evaluate_job, evaluation_config
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.learning.evaluation.episodes import TrainStatistics

__all__ = ["command", "train_job"]

MAY_CHANGE = ("total_timesteps", "dataset", "checkpoint", "eval", "video", "wandb")
"""Keys (and what is below them) that may differ from those of the run that is resumed, besides
those that may always."""

_log = logging.getLogger(__name__)


@verb(
    "train",
    ("train task=reach", "as the task suggests"),
    ("train task=reach total_timesteps=8192", "shorter"),
    ("train task=reach algo.learning_rate=3e-4 seed=1", "another learning rate and seed"),
    ("train task=reach algo=sac algo.normalize=obs", "another algorithm; normalized"),
    ("train resume=last total_timesteps=400_000", "resume from the newest checkpoint"),
    ("train -m task=reach seed=0,1,2", "a sweep: one training for each seed"),
    keys=True,
    config_dir=True,
    quiet=True,
)
@job_arguments("train")
def command(**kwargs: Any) -> None:
    """Train once, or once for each point of a sweep."""
    options = SimpleNamespace(**kwargs)
    lines = resumption(options)
    if lines is None:
        start("train", train_job, options)
    else:
        execute(_resumed(lines), train_job, command_line(), verb="train")


def train_job(job: Job) -> float | None:
    """Train, evaluate the policy and print the results of both."""
    episodes, seed = job.root.eval.episodes, job.root.seed
    asked = evaluated = None
    if episodes and seed is not None:  # as `embodichain eval RUN`; checked before training
        asked = Asked(episodes, seed)
        evaluated = evaluation_config(job.resolved, asked)
    summary = _learned(job) or _learn(job)
    if asked is not None and evaluated is not None and summary["status"] == "finished":
        summary |= _evaluate(job, evaluated, asked)
    if job.root.json:
        print_json(summary)
    elif not job.root.quiet:
        rows = [*training_rows(summary), ("folder", summary["folder"])]
        print_facts(str(summary["task"]), rows)
    objective: float | None = summary["objective"]
    return objective


def _learned(job: Job) -> dict[str, Any] | None:
    """The content of `summary.json` if the job learned to the end before it was started again."""
    from embodichain.cli.sweeps.sweep_jobs import read_summary

    summary = read_summary(job.folder)
    return {**summary, "folder": str(job.folder)} if summary.get("status") == "finished" else None


def _learn(job: Job) -> dict[str, Any]:
    """Train to the end or until a signal; returns the content of `summary.json`."""
    from embodichain.cli.jobs.dashboard import Dashboard
    from embodichain.config.keys.algorithms import DEFAULT_ALGORITHM
    from embodichain.config.run_folder import SUMMARY
    from embodichain.learning.training.train import train

    started()
    root = job.root
    algo = root.algo.name if root.algo is not None else DEFAULT_ALGORITHM
    about = job.resolved.task_name, algo, root.total_timesteps or 0
    with _said_if_failed(job, algo), Dashboard(*about, quiet=job.quiet) as display:

        def progress(statistics: TrainStatistics) -> None:
            job.began.set()
            if job.stop.is_stopped():
                raise Interrupted
            if display.due:
                display.update(statistics)

        # Interrupted: checkpoint and summary have been written; the job ends with code 130.
        with suppress(Interrupted):
            learned = train(
                *(job.resolved, job.folder, progress),
                lambda env: job.attach_viewer(env, realtime=False),
                lambda env: read_dataset(job, env),
            )
            summary = job.resolved.record(dataclasses.asdict(learned))
            return {**summary, "folder": str(job.folder)}
    if not (job.folder / SUMMARY).is_file():
        message = f"interrupted ({job.stop.stopped}) before the first update"
        raise Interrupted.by(job.stop.stopped, message)
    summary = json.loads((job.folder / SUMMARY).read_text())
    return {**summary, "folder": str(job.folder)}


@contextmanager
def _said_if_failed(job: Job, algo: str) -> Iterator[None]:
    """Write a `summary.json` if the training dies of an exception; that is raised again."""
    from embodichain.config.run_folder import SUMMARY

    try:
        yield
    except Exception as error:
        about = {"task": job.resolved.task_name, "algo": algo, "seed": job.root.seed}
        failed = {**about, "folder": str(job.folder), "status": "failed", "error": repr(error)}
        try:
            text = to_json(job.resolved.record(failed), indent=2)
            write_text(job.folder / SUMMARY, text + "\n")
        except OSError as second:  # a full disk fails here too; the first error is reported
            _log.warning("%s could not be written: %s", SUMMARY, second)
        raise


def _evaluate(job: Job, evaluated: Resolved, asked: Asked) -> dict[str, Any]:
    """Evaluate the final checkpoint; returns the summary with the results."""
    from embodichain.config.environments.host_arrays import why_host, with_arrays
    from embodichain.config.run_folder import CHECKPOINT
    from embodichain.learning.training.train import add_evaluation

    evaluated = evaluated.changed(policy=str((job.folder / CHECKPOINT).resolve()))
    reasons = why_host(evaluated.root, "run")
    if reasons and evaluated.root.sim.warp.arrays == "device":
        evaluated = with_arrays(evaluated, "host")
        _log.warning("the evaluation has arrays on the host, because %s", "; ".join(reasons))
    found = evaluate_job(dataclasses.replace(job, resolved=evaluated), asked)
    return add_evaluation(job.folder, found) | job.film(found["log"])


def _resumed(overrides: Sequence[str]) -> Resolved:
    """The config of a training that is resumed.

    Args:
        overrides: As typed: ``resume=RUN`` (or ``last``) and keys that may change.

    Raises:
        ConfigError: There is no such run, none of its checkpoints can be resumed, or an override
            sets a key that may not change.
    """
    from embodichain.config.rerun import read_config
    from embodichain.config.resolved import resolve_tree
    from embodichain.config.run_folder import CONFIG, newest_run
    from embodichain.learning.checkpoints.checkpoint import read_note
    from embodichain.learning.training.keeper import find_resumable
    from embodichain.learning.training.train import check_training, check_unfinished

    changes = parsed_changes(overrides, MAY_CHANGE, "a resumed training")
    name = str(changes.pop("resume"))
    output_dir = changes.get("output_dir", "outputs")
    folder = resumed_folder(name, newest_run(output_dir, "checkpoints/*.zip"), "training")
    checkpoint, state = find_resumable(folder)
    fresh: dict[str, Any] = {"quiet": False, "json": False, "traceback": False}
    fresh |= {"allow_changed": False, "trust": False, "resume": str(folder)}
    tree = with_changes({**read_config(folder / CONFIG), **fresh}, changes)
    task = str(read_note(checkpoint).get("task", "task"))
    source = str(folder / CONFIG)
    found = resolve_tree(tree, source, "train", task_name=task, allow_import=True)
    check_training(found)
    check_unfinished(checkpoint, state["env_steps"], found.root.total_timesteps or 0)
    return dataclasses.replace(found, overrides=tuple(overrides))
