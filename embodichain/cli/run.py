"""`embodichain run`: build a task, play a policy in it, keep what happened in a run folder."""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from embodichain.cli.app import jobs, typed, verb
from embodichain.cli.attach import (
    StartPicture,
    attach_log,
    attach_viewer,
    check_attachments,
    film_job,
    policy_of,
)
from embodichain.cli.exits import Interrupted
from embodichain.cli.jobs import Job
from embodichain.cli.launch import start
from embodichain.cli.output import print_json, to_json
from embodichain.cli.process import StopFlag, started
from embodichain.cli.progress import ProgressDisplay
from embodichain.cli.rollout import Outcome, print_summary, roll_out, summarize
from embodichain.utils.atomic import write_text

__all__ = ["SUMMARY_FILE", "command", "run_job"]

SUMMARY_FILE = "summary.json"
_log = logging.getLogger(__name__)


@verb(
    "run",
    ("run task=random_reach num_envs=4", "as the task suggests, four environments"),
    ("run task=random_reach episodes=2 seed=1 record=none", "two episodes each, no log"),
    ("run task=random_reach task.physics.physics_dt=0.005", "change any value of the task"),
    ("run task=reach policy=outputs/latest", "play what was trained there"),
    ("run -m task=random_reach seed=0,1", "a sweep: one run for each seed"),
    ("run --gym-config gym_config.yaml", "a task in EmbodiChain's own form"),
    ("run task=random_reach --cfg job", "print the config, run nothing"),
    keys=True,
)
@jobs("run")
def command(**options: Any) -> None:
    """Run once, or once for each point of a sweep."""
    start("run", run_job, SimpleNamespace(**options), typed())


def run_job(run: Job, stop: StopFlag) -> float | None:
    """Build, play, close, sum up; a failure is kept in `summary.json` too."""
    root = run.root
    facts: dict[str, Any] = {
        "task": run.resolved.task_name,
        "folder": str(run.folder),
        "seed": root.seed,
        "policy": root.policy if isinstance(root.policy, (str, type(None))) else root.policy.func,
    }
    if not run.quiet:
        sys.stderr.write(f"{facts['task']}: {run.folder}\n")
    check_attachments(root)
    try:
        outcome, log = _simulate(run, stop)
    except Exception as error:
        try:
            _write_summary(run.folder, {**facts, "status": "failed", "error": repr(error)})
        except OSError as second:  # a full disk fails here too; what came first is what is told
            _log.error("%s could not be written: %s", SUMMARY_FILE, second)
        raise
    if log is not None:
        facts |= {"log": str(log), "log_bytes": log.stat().st_size}
    summary = summarize(outcome, facts)
    _write_summary(run.folder, summary)
    _log.info("summary: %s", json.dumps(summary, default=str))
    summary |= film_job(run, stop, log)
    if root.json:
        print_json(summary)
    elif not root.quiet:
        print_summary(summary)
    if stop.stopped is not None:
        raise Interrupted(f"interrupted ({stop.stopped}); {run.folder} is complete up to there")
    return outcome.statistics.mean("return")


def _simulate(run: Job, stop: StopFlag) -> tuple[Outcome, Path | None]:
    """The rollout from build to close, and where its log is."""
    from embodichain.config.factory import make_env

    root = run.root
    episodes = root.episodes or 1
    env = make_env(run.resolved, run_dir=run.folder)
    start: StartPicture | None = None
    try:
        policy = policy_of(root, env)
        recorder = attach_log(run, env)
        attach_viewer(root, env, stop)
        obs, _ = env.reset()
        start = StartPicture(env) if root.scene_png else None
        started()
        label, total = run.resolved.task_name, env.num_envs * episodes
        with ProgressDisplay(label, total, "episodes", quiet=run.quiet) as display:
            outcome = roll_out(env, policy, obs, episodes, root.max_steps, display, stop)
    finally:
        env.close()  # finishes the log too
        if start is not None:
            start.draw(run.folder / "scene.png")
    return outcome, recorder.stats.path if recorder is not None else None


def _write_summary(folder: Path, summary: dict[str, Any]) -> None:
    write_text(folder / SUMMARY_FILE, to_json(summary, indent=2) + "\n")
