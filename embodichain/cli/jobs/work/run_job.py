"""`run_job`: build a task, run a policy in it, write log and summary to the run folder."""

from __future__ import annotations

import json
import logging
import sys
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli.jobs.job import Job, policy_of
from embodichain.cli.jobs.work.summary_file import failure_in_summary, write_summary
from embodichain.cli.results.summaries import run_rows
from embodichain.cli.terminal.output import print_facts, print_json, result_number
from embodichain.cli.terminal.reporting import ProgressDisplay, episodes_of
from embodichain.lab.gym.failures import failed_in
from embodichain.learning.episode_statistics import EpisodeStatistics, play

if TYPE_CHECKING:
    from embodichain.cli.jobs.watching import Watching
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.policies import Policy
    from embodichain.recording.write.recorder import RecordStats

__all__ = ["run_job"]

_PICTURE_SIZE = (1280, 960)
_log = logging.getLogger(__name__)


def run_job(job: Job) -> float | None:
    """Build, roll out, close and summarize; a failure is written to `summary.json` too.

    Returns:
        The mean return, the objective for a sweeper.
    """
    root = job.root
    policy = root.policy
    if policy is not None and not isinstance(policy, str):
        policy = policy.func
    facts: dict[str, Any] = {
        "task": job.resolved.task_name,
        "folder": str(job.folder),
        "seed": root.seed,
        "policy": policy,
    }
    with ExitStack() as run:
        with failure_in_summary(job, facts):
            simulated = _simulate(job, run)
        log_path = None
        if simulated.log is not None:
            log_path = simulated.log.path
            facts["log"] = str(log_path)
            facts["log_bytes"] = simulated.log.nbytes
        summary = {**facts, **simulated.results}
        write_summary(job, summary)
        _log.info("summary: %s", json.dumps(summary, default=str))
        summary |= job.film(log_path)
        if root.json:
            print_json(summary)
        elif not root.quiet:
            print_facts(str(summary["task"]), run_rows(summary))
        if simulated.watching is not None:
            sys.stdout.flush()
            simulated.watching.stay()
    returns = summary["return"]
    if returns is None:
        return None
    return returns["mean"]


@dataclass(frozen=True, slots=True)
class _Simulated:
    """What a simulation has left.

    Attributes:
        results: The statistics for `summary.json`.
        log: What was recorded, if anything.
        watching: Those who look at its viewer, which stays open until they are gone.
    """

    results: dict[str, Any]
    log: RecordStats | None
    watching: Watching | None


def _simulate(job: Job, run: ExitStack) -> _Simulated:
    """Build and roll out; the log is complete then.

    Args:
        job: The job.
        run: Closes the environment, and with it the viewer.
    """
    from embodichain.config.environments.factory import make_batch
    from embodichain.learning.checkpoints.curriculum_stage import hold_at_stage
    from embodichain.recording import McapRecorder

    root = job.root
    env = make_batch(job.resolved, compiled_scene=job.compiled_scene, run_dir=job.folder)
    run.callback(env.close)
    picture: _StartPicture | None = None
    watching: Watching | None = None
    try:
        policy = policy_of(root, env)
        hold_at_stage(env, policy)
        recorder = job.attach_log(env, quota=[root.episodes or 1] * env.num_envs)
        watching = job.watching(job.attach_viewer(env, policy))
        obs, _ = env.reset()
        if root.scene_png:
            picture = _StartPicture(env)
        job.begin()
        if watching is not None:
            watching.wait()
        results = _roll_out(env, policy, obs, job, watching)
        if watching is not None and isinstance(recorder, McapRecorder):
            recorder.close()  # the viewer stays, and who looks may end this process at any time
    finally:
        if watching is None:
            env.close()  # finishes the log too
        if picture is not None:
            picture.draw(job.folder / "scene.png")
    return _Simulated(
        results,
        log=None if recorder is None else recorder.stats,
        watching=watching,
    )


def _roll_out(
    env: BaseEnv, policy: Policy, obs: Any, job: Job, watching: Watching | None
) -> dict[str, Any]:
    """Step `env` with `policy` from `obs` to the end of the run; in real time if a window is open.

    `env` was just reset and resets its environments automatically; `policy` is reset for
    environments that begin a new episode.

    Returns:
        The statistics for `summary.json`. The status is ``finished`` if every environment completed
        its episodes, ``max_steps`` if the limit was reached, ``interrupted`` after a signal.
    """
    max_steps = job.root.max_steps
    stop = job.stop
    counted = EpisodeStatistics(env.num_envs, job.root.episodes or 1)
    start = time.perf_counter()
    status = "finished"
    unit = episodes_of(env.num_envs)
    with ProgressDisplay(job.resolved.task_name, counted.wanted, unit, quiet=job.quiet) as display:

        def show() -> None:
            seconds = time.perf_counter() - start
            display.show(counted.episodes, _facts(counted, max_steps, seconds))

        steps = play(env, policy, obs, counted)
        if job.root.sim.backend == "ray":
            from embodichain.cli.jobs.sharding import play_inside

            inside = play_inside(job.root, env, counted)
            if inside is not None:
                steps = inside
        if stop.is_stopped():  # while the environment was built: no step is made
            status = "interrupted"
            steps = iter(())
        for _ in steps:
            if watching is not None:
                watching.hold()
            if env.sim.is_window_open:  # in real time
                time.sleep(max(0.0, start + counted.steps * env.step_dt - time.perf_counter()))
            if display.due:
                show()
            if counted.complete:  # the last step: the loop ends by itself, as finished
                continue
            if stop.is_stopped():
                status = "interrupted"
                break
            if max_steps is not None and counted.steps >= max_steps:
                status = "max_steps"
                break
        seconds = time.perf_counter() - start
        show()
    results = {"status": status, "signal": stop.stopped, **_results(counted, seconds)}
    # A batch in shards has no terms here: each shard warns of its own.
    not_finite = getattr(env, "not_finite_terms", {})
    if not_finite:
        results["not_finite"] = not_finite
    return results


def _results(counted: EpisodeStatistics, seconds: float) -> dict[str, Any]:
    """The part of `summary.json` about the episodes, which took some seconds."""
    env_steps = counted.steps * counted.num_envs
    return {
        "num_envs": counted.num_envs,
        "control_steps": counted.steps,
        "env_steps": env_steps,
        "seconds": round(seconds, 6),
        "fps": round(env_steps / seconds, 3),
        "episodes": counted.episodes,
        "episodes_wanted": counted.wanted,
        "return": _spread(counted, "return"),
        "length": _spread(counted, "length"),
        "success_rate": counted.mean("success"),
        "terminated": int(counted.column("terminated").sum()),
        "diverged": int(counted.column("diverged").sum()),
        "metrics": _means(counted, "metrics/"),
        "rewards": _means(counted, "rewards/"),
        **_failures(counted),
    }


def _facts(counted: EpisodeStatistics, max_steps: int | None, seconds: float) -> dict[str, str]:
    """The numbers shown beside the progress bar."""
    steps = str(counted.steps)
    if max_steps is not None:
        steps += f"/{max_steps}"
    fps = counted.steps * counted.num_envs / seconds
    facts = {"step": steps, "FPS": f"{fps:,.0f}"}
    mean_return = counted.mean("return")
    success = counted.mean("success")
    if mean_return:  # a task without rewards always returns 0
        facts["return"] = result_number(mean_return)
    if success is not None:
        facts["success"] = f"{success:.0%}"
    return facts


def _spread(counted: EpisodeStatistics, name: str) -> dict[str, float] | None:
    column = counted.column(name)
    if not column.size:
        return None
    return {
        "mean": float(column.mean()),
        "std": float(column.std()),
        "min": float(column.min()),
        "max": float(column.max()),
    }


def _means(counted: EpisodeStatistics, prefix: str) -> dict[str, float | None]:
    names = [name for name in counted.names() if name.startswith(prefix)]
    return {name.removeprefix(prefix): counted.mean(name) for name in names}


def _failures(counted: EpisodeStatistics) -> dict[str, Any]:
    """How many episodes of an expert failed in each step, and why the first of them did.

    Every failure is a line of `run.log`.
    """
    if "failure" not in counted.names():
        return {}
    failures_in_step: Counter[str] = Counter()
    first_failure: dict[str, str] = {}
    envs = counted.column("env")
    episodes = counted.column("episode")
    for env, episode, failure in zip(envs, episodes, counted.column("failure"), strict=True):
        if failure:
            _log.info("episode %d of environment %d failed: %s", episode, env, failure)
            step = failed_in(failure)
            failures_in_step[step] += 1
            first_failure.setdefault(step, failure)
    most_first = dict(failures_in_step.most_common())
    return {
        "failed_in": most_first,
        "failed_for": {step: first_failure[step] for step in most_first},
    }


class _StartPicture:
    """Environment 0 as it is at construction, rendered when the run ends."""

    def __init__(self, env: BaseEnv) -> None:
        template: BaseEnv | None = getattr(env, "template", None)
        if template is not None:  # a batch in shards, whose states are in other processes
            template.reset()
            env = template
        self._data = env.sim.engine.data_of(0)

    def draw(self, path: Path) -> None:
        """Write the picture; warn if there is no OpenGL or the file cannot be written."""
        from contextlib import closing

        from PIL import Image

        from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
        from embodichain.lab.sim.drawing.states import DataState
        from embodichain.utils.errors import RenderError
        from embodichain.utils.system.atomic import atomic_file

        state = DataState(self._data)
        try:
            with closing(OffscreenRenderer(state.model)) as renderer:
                pixels = renderer.pictures(state, "default", _PICTURE_SIZE)[0]
            with atomic_file(path) as temporary:
                Image.fromarray(pixels).save(temporary, format="PNG")
        except (RenderError, OSError) as error:
            _log.warning("no scene.png: %s", error)
