"""`embodichain run`: build a task, play a policy in it, keep what happened in a run folder.

The loop is `rollout`, what Hydra does around it `hydra_verb`; this is the story from one config to
one summary.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from omegaconf import DictConfig

from embodichain.cli.exits import Interrupted
from embodichain.cli.filming import check_film, film_job
from embodichain.cli.hydra_verb import call_verb
from embodichain.cli.jobs import Job, execute
from embodichain.cli.stopping import StopFlag

if TYPE_CHECKING:
    from embodichain.cli.rollout import Outcome

__all__ = ["job", "main"]

SUMMARY_FILE = "summary.json"
_log = logging.getLogger(__name__)


def main(arguments: list[str]) -> int:
    """Run once, or once for each point of a sweep."""
    return call_verb("run", job, arguments)


@hydra.main(version_base="1.3", config_path="pkg://embodichain.conf", config_name="run")
def job(composed: DictConfig) -> float | None:
    """One run, called here or by Hydra. Returns the mean return, which a sweeper may optimise."""
    return execute("run", _run)


def _run(run: Job, stop: StopFlag) -> float | None:
    """Build, play, close, sum up; a failure is kept in `summary.json` too."""
    from embodichain.cli.summary import print_summary, summarize

    root = run.root
    facts: dict[str, Any] = {
        "task": run.resolved.task_name,
        "folder": str(run.folder),
        "seed": root.seed,
        "policy": root.policy if isinstance(root.policy, (str, type(None))) else root.policy.func,
    }
    if not root.quiet and not root.json:
        sys.stderr.write(f"{facts['task']}: {run.folder}\n")
    check_film(run)
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
        from embodichain.cli.arguments import print_json

        print_json(summary)
    elif not root.quiet:
        print_summary(summary)
    if stop.stopped is not None:
        raise Interrupted(f"interrupted ({stop.stopped}); {run.folder} is complete up to there")
    return outcome.statistics.mean("return")


def _simulate(run: Job, stop: StopFlag) -> tuple[Outcome, Path | None]:
    """The rollout from build to close, and where its log is."""
    from embodichain.cli.attach import attach_log
    from embodichain.cli.picture import StartPicture
    from embodichain.cli.policies import policy_of
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.cli.rollout import play
    from embodichain.cli.starting import started
    from embodichain.cli.viewing import attach_viewer
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
        with ProgressDisplay(label, total, "episodes", quiet=root.quiet or root.json) as display:
            outcome = play(
                env,
                policy,
                obs,
                episodes=episodes,
                max_steps=root.max_steps,
                display=display,
                stop=stop,
            )
    finally:
        env.close()  # finishes the log too
        if start is not None:
            start.draw(run.folder / "scene.png")
    return outcome, recorder.stats.path if recorder is not None else None


def _write_summary(folder: Path, summary: dict[str, Any]) -> None:
    from embodichain.cli.arguments import to_json
    from embodichain.config.run_folder import write_atomically

    write_atomically(folder / SUMMARY_FILE, to_json(summary, indent=2) + "\n")
