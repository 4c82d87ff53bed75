"""`collect_job`: record episodes of a policy until enough of them succeeded."""

from __future__ import annotations

import dataclasses
import json
import logging
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli.jobs.job import Job, policy_name, policy_of
from embodichain.cli.jobs.receipt import RECEIPT, write_receipt
from embodichain.cli.jobs.work.summary_file import failure_in_summary, write_summary
from embodichain.cli.results.summaries import collection_rows
from embodichain.cli.terminal.output import print_facts, print_json
from embodichain.cli.terminal.reporting import ProgressDisplay, episodes_of
from embodichain.config.run_folder import LOG
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.recording import McapRecorder
    from embodichain.recording.demos.collecting import Collected, Collector
    from embodichain.recording.demos.collection import CollectionWriter

__all__ = ["CollectionError", "collect_job"]

_log = logging.getLogger(__name__)


class CollectionError(Exception):
    """A collection gave up."""


def collect_job(job: Job) -> float | None:
    """Collect into the job's folder, write `summary.json` and print the results.

    Args:
        job: A job with a config of the verb `collect`.

    Returns:
        The yield.

    Raises:
        CollectionError: Too many episodes failed in a row.
    """
    from embodichain.recording.demos.collection import CollectionWriter

    root = job.root
    facts = {
        "task": job.resolved.task_name,
        "folder": str(job.folder),
        "seed": root.seed,
        "policy": policy_name(root),
    }
    with CollectionWriter(job.folder) as writer:
        with failure_in_summary(job, facts):
            summary = facts | _collect(job, writer)
        write_summary(job, summary)
    if summary["status"] == "finished":
        _write_receipt(job, summary)
    _log.info("summary: %s", json.dumps(summary, default=str))
    summary |= job.film(summary["log"])
    if root.json:
        print_json(summary)
    elif not root.quiet:
        print_facts(str(summary["task"]), collection_rows(summary))
    if summary["status"] == "gave_up":
        most_frequent = next(iter(summary["failed_in"]))
        raise CollectionError(
            f"gave up after {root.collect.give_up_after} failures in a row, most of all: "
            f"{most_frequent} (collect.give_up_after)"
        )
    return summary["yield"]


def _write_receipt(job: Job, summary: dict[str, Any]) -> None:
    """Write the receipt of a complete collection."""
    facts = {
        "task": summary["task"],
        "policy": summary["policy"],
        "seed": summary["seed"],
        "results": {name: summary[name] for name in ("successes", "failures", "yield")},
    }
    files = sorted(
        path for path in job.folder.iterdir() if path.suffix in (".mcap", ".json", ".jsonl")
    )
    write_receipt(
        job.folder,
        "collect",
        facts,
        files=[path for path in files if path.name != RECEIPT],
        logs=[job.folder / name for name in summary["logs"]],
    )


def _collect(job: Job, writer: CollectionWriter) -> dict[str, Any]:
    """Build, collect and close; returns the summary."""
    from embodichain.config.environments.factory import make_env
    from embodichain.learning.checkpoints.curriculum_stage import hold_at_stage
    from embodichain.recording.demos.attempts import Attempts
    from embodichain.recording.demos.collecting import Collected, Collector, EndRules
    from embodichain.recording.demos.collection import new_log, read_collection

    root = job.root
    num_successes = root.episodes or 1
    earlier_episodes = read_collection(job.folder, failures=True)
    collected = Collected()
    for episode in earlier_episodes:
        collected.add(episode)
    collected.failures_in_a_row = 0
    succeeded = [episode.attempt for episode in earlier_episodes if episode.success is True]
    failed = [episode.attempt for episode in earlier_episodes if episode.success is False]
    # An earlier start may have ended between its last episode and its summary.
    if earlier_episodes and collected.successes >= num_successes:
        logs = sorted({episode.log for episode in earlier_episodes})
        log = str(job.folder / earlier_episodes[-1].log)
        results = _results(job, collected, num_envs=0, steps=0, seconds=0.0)
        return results | {"log": log, "logs": logs}
    attempts = Attempts(num_successes, succeeded, failed)
    # No more environments than successes are missing: the others would play for nothing.
    num_envs = min(root.num_envs or 1, num_successes - collected.successes)
    name = new_log(job.folder, LOG)
    run_dir = job.folder
    if name != LOG:  # files of this start beside those of earlier ones
        run_dir = job.folder / Path(name).stem
    resolved = job.resolved.changed(num_envs=num_envs)
    env = make_env(
        resolved,
        compiled_scene=job.compiled_scene,
        run_dir=run_dir,
        autoreset_mode="DISABLED",
    )
    try:
        policy = policy_of(root, env)
        hold_at_stage(env, policy)
        recorder: McapRecorder | None = dataclasses.replace(job, resolved=resolved).attach_log(
            env, name
        )
        job.attach_viewer(env, policy, realtime=False)
        if recorder is None:
            raise ConfigError([Problem("record.format", "a collection is a log")])
        rules = EndRules(root.collect.success_steps, root.collect.wait_steps)
        collector = Collector(
            env,
            policy,
            recorder=recorder,
            writer=writer,
            attempts=attempts,
            rules=rules,
            collected=collected,
        )
        job.begin()
        results = _play(job, env, collector)
    finally:
        env.close()  # finishes the log too
    log = recorder.stats.path
    logs = sorted({episode.log for episode in earlier_episodes} | {log.name})
    return results | {"log": str(log), "logs": logs}


def _play(job: Job, env: BaseEnv, collector: Collector) -> dict[str, Any]:
    """Collect until the collection is complete, or something ends it; returns the results."""
    root = job.root
    stop = job.stop
    collected = collector.collected
    num_successes = root.episodes or 1
    successes_before = collected.successes
    limit = root.max_steps or float("inf")
    patience = root.collect.give_up_after or float("inf")
    status = "finished"
    steps = 0
    start = time.perf_counter()
    task = job.resolved.task_name

    def rate() -> float:
        """Successes per second since the start or the resumption."""
        return (collected.successes - successes_before) / max(time.perf_counter() - start, 1e-9)

    unit = episodes_of(env.num_envs, "successes")
    with ProgressDisplay(task, num_successes, unit, quiet=job.quiet) as display:
        try:
            for steps, _ in enumerate(collector.play(), 1):
                if env.sim.is_window_open:  # in real time
                    time.sleep(max(0.0, start + steps * env.step_dt - time.perf_counter()))
                if display.due:
                    display.show(collected.successes, _facts(collected, num_successes, rate()))
                if collector.complete:
                    break
                if stop.is_stopped():
                    status = "interrupted"
                elif collected.failures_in_a_row >= patience:
                    status = "gave_up"
                elif steps >= limit:
                    status = "max_steps"
                if status != "finished":
                    break
        finally:
            collector.write()
        seconds = time.perf_counter() - start
        display.show(collected.successes, _facts(collected, num_successes, rate()))
    results = _results(job, collected, num_envs=env.num_envs, steps=steps, seconds=seconds)
    return results | {"status": status, "episodes_per_minute": round(60 * rate(), 3)}


def _results(
    job: Job, collected: Collected, *, num_envs: int, steps: int, seconds: float
) -> dict[str, Any]:
    """The part of `summary.json` about the episodes of a collection that is complete.

    Args:
        job: The job.
        collected: Numbers of all its episodes, those of earlier starts among them.
        num_envs: Number of environments of this start.
        steps: Control steps of this start.
        seconds: Its duration.
    """
    return {
        "status": "finished",
        "signal": job.stop.stopped,
        "num_envs": num_envs,
        "successes": collected.successes,
        "successes_wanted": job.root.episodes or 1,
        "failures": collected.failures,
        "yield": collected.share,
        "failed_in": dict(collected.failed_in.most_common()),
        "episodes_per_minute": 0.0,
        "mean_length": collected.mean_length,
        "control_steps": steps,
        "env_steps": steps * num_envs,
        "seconds": round(seconds, 6),
        "fps": round(steps * num_envs / seconds, 3) if seconds else 0.0,
    }


def _facts(collected: Collected, num_successes: int, rate: float) -> dict[str, str]:
    """The numbers shown beside the progress bar."""
    facts = {}
    if collected.share is not None:
        facts["yield"] = f"{collected.share:.1%}"
    if rate > 0:
        minutes, seconds = divmod(round((num_successes - collected.successes) / rate), 60)
        facts["per minute"] = f"{60 * rate:,.0f}"
        facts["left"] = f"{minutes}:{seconds:02}"
    return facts
