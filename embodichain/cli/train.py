"""`embodichain train`: learn a policy with Stable-Baselines3, keep it in a run folder.

Learning itself is `embodichain.learning`; this starts it, shows it and sums it up.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import hydra
from omegaconf import DictConfig

from embodichain.cli.evaluated import brief_rows
from embodichain.cli.evaluating import Asked, evaluate_job, evaluation_config
from embodichain.cli.exits import Interrupted
from embodichain.cli.filming import check_film, film_job
from embodichain.cli.hydra_verb import call_verb
from embodichain.cli.jobs import Job, execute
from embodichain.cli.stopping import StopFlag

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.learning.episodes import TrainStatistics

__all__ = ["job", "main"]


def main(arguments: list[str]) -> int:
    """Train once, or once for each point of a sweep."""
    return call_verb("train", job, arguments)


@hydra.main(version_base="1.3", config_path="pkg://embodichain.conf", config_name="train")
def job(composed: DictConfig) -> float | None:
    """One training, called here or by Hydra. Returns what a sweeper optimises: `objective`."""
    return execute("train", _train)


def _train(run: Job, stop: StopFlag) -> float | None:
    """Learn, evaluate what was learned, show both."""
    check_film(run)
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
    from embodichain.config.frozen import freeze
    from embodichain.config.newest import CHECKPOINT
    from embodichain.learning.train import add_evaluation

    policy = str((run.folder / CHECKPOINT).resolve())
    resolved = dataclasses.replace(evaluated, tree=freeze({**evaluated.tree, "policy": policy}))
    found = evaluate_job(Job(resolved, resolved.root, run.folder), stop, asked)
    summary = add_evaluation(run.folder, found)
    return summary | film_job(run, stop, found["log"])


def _learn(run: Job, stop: StopFlag) -> dict[str, Any]:
    """Learn until it ends or somebody stops it; returns what `summary.json` holds."""
    from embodichain.cli.dashboard import Dashboard
    from embodichain.cli.starting import started
    from embodichain.cli.viewing import attach_viewer
    from embodichain.config.algorithms import DEFAULT_ALGORITHM
    from embodichain.learning.train import SUMMARY_FILE, train

    started()
    root = run.root
    quiet = root.quiet or root.json
    if not quiet:
        sys.stderr.write(f"{run.resolved.task_name}: {run.folder}\n")
    algo = root.algo.name if root.algo is not None else DEFAULT_ALGORITHM
    about = run.resolved.task_name, algo, root.total_timesteps
    with Dashboard(*about, quiet=quiet) as display:

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
    summary: dict[str, Any] = json.loads((run.folder / SUMMARY_FILE).read_text())
    return {**summary, "folder": str(run.folder)}


def _show(run: Job, summary: dict[str, Any]) -> None:
    """The closing table, or JSON."""
    if run.root.json:
        from embodichain.cli.arguments import print_json

        print_json(summary)
    elif not run.root.quiet:
        from embodichain.cli.tables import print_facts

        task = str(summary["task"])
        apart = ("task", "eval", "folder")
        rows = [(k.replace("_", " "), v) for k, v in summary.items() if k not in apart]
        shares = [f"{name} {share:.0%}" for name, share in summary["time_fractions"].items()]
        rows = [(k, shares if k == "time fractions" else v) for k, v in rows]
        if summary["eval"] is not None:
            rows += brief_rows(summary["eval"])
        print_facts(task, [*rows, ("folder", summary["folder"])])
