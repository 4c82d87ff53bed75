"""`embodichain train`: learn a policy with Stable-Baselines3, or resume a training.

``resume=RUN`` reads the config from the run's `config.yaml`. It is the same experiment, so only few
keys may change. It continues in a new folder; the files of the earlier run are not changed.
"""

from __future__ import annotations

from embodichain.cli.jobs.job import execute, start
from embodichain.cli.jobs.resuming import resolve_resumed_training, resuming_overrides
from embodichain.cli.jobs.work.train_job import train_job
from embodichain.cli.verb import JobOptions, command_line, job_arguments, verb

__all__ = ["command"]


@verb(
    "train",
    ("train task=reach", "as the task suggests"),
    ("train task=reach total_timesteps=8192", "shorter"),
    ("train task=reach algo.learning_rate=3e-4 seed=1", "another learning rate and seed"),
    ("train task=reach algo=sac algo.normalize=obs", "another algorithm; normalized"),
    ("train resume=last total_timesteps=400_000", "resume from the newest checkpoint"),
    ("train -m task=reach seed=0,1,2", "a sweep: one training for each seed"),
    options=JobOptions,
    keys=True,
    config_dir=True,
    quiet=True,
)
@job_arguments("train")
def command(options: JobOptions) -> None:
    """Train once, or once for each point of a sweep."""
    lines = resuming_overrides(options)
    if lines is None:
        start("train", train_job, options)
    else:
        execute(resolve_resumed_training(lines), train_job, command_line(), verb="train")
