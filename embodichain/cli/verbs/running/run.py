"""`embodichain run`: build a task, run a policy in it, write log and summary to a run folder."""

from __future__ import annotations

from embodichain.cli.jobs.job import start
from embodichain.cli.jobs.work.run_job import run_job
from embodichain.cli.verb import JobOptions, job_arguments, verb

__all__ = ["command"]


@verb(
    "run",
    ("run task=random_reach num_envs=4", "as the task suggests, four environments"),
    ("run task=random_reach episodes=2 seed=1 record=none", "two episodes each, no log"),
    ("run task=random_reach task.physics.physics_dt=0.005", "change any value of the task"),
    ("run task=reach policy=outputs/latest", "play the policy that was trained there"),
    ("run -m task=random_reach seed=0,1", "a sweep: one run for each seed"),
    ("run --gym-config gym_config.yaml", "a task in EmbodiChain's own form"),
    ("run task=random_reach --cfg job", "print the config, run nothing"),
    options=JobOptions,
    keys=True,
    config_dir=True,
    quiet=True,
)
@job_arguments("run")
def command(options: JobOptions) -> None:
    """Run once, or once for each point of a sweep."""
    start("run", run_job, options)
