"""`embodichain train`: learn a policy with Stable-Baselines3, keep it in a run folder."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from embodichain.cli.app import jobs, typed, verb
from embodichain.cli.attach import attach_viewer, check_attachments, film_job
from embodichain.cli.evaluating import Asked, brief_rows, evaluate_job, evaluation_config
from embodichain.cli.exits import Interrupted
from embodichain.cli.jobs import Job
from embodichain.cli.launch import start
from embodichain.cli.output import print_facts, print_json
from embodichain.cli.process import StopFlag, started

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.learning.episodes import TrainStatistics

__all__ = ["command", "train_job"]


@verb(
    "train",
    ("train task=reach", "as the task suggests"),
    ("train task=reach total_timesteps=8192", "shorter"),
    ("train task=reach algo.learning_rate=3e-4 seed=1", "another learning rate and seed"),
    ("train task=reach algo=sac algo.normalize=obs", "another algorithm; normalized"),
    ("train resume=last total_timesteps=400_000", "go on from the newest checkpoint"),
    ("train -m task=reach seed=0,1,2", "a sweep: one training for each seed"),
    keys=True,
)
@jobs("train")
def command(**options: Any) -> None:
    """Train once, or once for each point of a sweep."""
    start("train", train_job, SimpleNamespace(**options), typed())


def train_job(run: Job, stop: StopFlag) -> float | None:
    """Learn, evaluate what was learned, show both."""
    check_attachments(run.root)
    asked = _asked(run)
    evaluated = None if asked is None else evaluation_config(run.resolved, asked)
    summary = _learn(run, stop)
    if asked is not None and evaluated is not None and summary["status"] == "finished":
        summary |= _evaluate(run, evaluated, stop, asked)
    _show(run, summary)
    if summary["status"] == "interrupted" or stop.stopped is not None:
        raise Interrupted(f"interrupted ({stop.stopped}); what was learned is in {run.folder}")
    objective: float | None = summary["objective"]
    return objective


def _asked(run: Job) -> Asked | None:
    """The evaluation that is to follow, that of `embodichain eval RUN`."""
    episodes, seed = run.root.eval.episodes, run.root.seed
    return Asked(episodes, seed) if episodes and seed is not None else None


def _evaluate(run: Job, evaluated: Resolved, stop: StopFlag, asked: Asked) -> dict[str, Any]:
    """Play the final checkpoint; returns the summary with what was found."""
    from embodichain.config.run_folder import CHECKPOINT
    from embodichain.learning.train import add_evaluation

    policy = str((run.folder / CHECKPOINT).resolve())
    found = evaluate_job(Job(evaluated.changed(policy=policy), run.folder), stop, asked)
    summary = add_evaluation(run.folder, found)
    return summary | film_job(run, stop, found["log"])


def _learn(run: Job, stop: StopFlag) -> dict[str, Any]:
    """Learn until it ends or somebody stops it; returns what `summary.json` holds."""
    from embodichain.cli.dashboard import Dashboard
    from embodichain.config.algorithms import DEFAULT_ALGORITHM
    from embodichain.config.run_folder import SUMMARY
    from embodichain.learning.train import train

    started()
    root = run.root
    if not run.quiet:
        sys.stderr.write(f"{run.resolved.task_name}: {run.folder}\n")
    algo = root.algo.name if root.algo is not None else DEFAULT_ALGORITHM
    about = run.resolved.task_name, algo, root.total_timesteps
    with Dashboard(*about, quiet=run.quiet) as display:

        def progress(statistics: TrainStatistics) -> None:
            if stop.stopped is not None:
                raise Interrupted
            if display.due:
                display.show(statistics)

        def attach(env: BaseEnv) -> None:
            attach_viewer(root, env, stop, realtime=False)

        # Interrupted: checkpoint and summary are written by then; the job says so and leaves.
        with suppress(Interrupted):
            train(run.resolved, run.folder, progress, attach)
    summary: dict[str, Any] = json.loads((run.folder / SUMMARY).read_text())
    return {**summary, "folder": str(run.folder)}


def _show(run: Job, summary: dict[str, Any]) -> None:
    """The closing table, or JSON."""
    if run.root.json:
        print_json(summary)
    elif not run.root.quiet:
        task = str(summary["task"])
        apart = ("task", "eval", "folder")
        rows = [(k.replace("_", " "), v) for k, v in summary.items() if k not in apart]
        shares = [f"{name} {share:.0%}" for name, share in summary["time_fractions"].items()]
        rows = [(k, shares if k == "time fractions" else v) for k, v in rows]
        if summary["eval"] is not None:
            rows += brief_rows(summary["eval"])
        print_facts(task, [*rows, ("folder", summary["folder"])])
