"""From the command line of `run` and `train` to jobs.

A single job is composed with Hydra's compose API and executed here. Sweeps, ``--cfg`` and
``--info`` go through Hydra's own `main`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from embodichain.cli.app import job_options, split_overrides
from embodichain.cli.jobs import Body, Verb, execute, resolved_job
from embodichain.utils.errors import ConfigError

__all__ = ["start"]


def start(verb: Verb, body: Body, options: Any, typed: Sequence[str]) -> None:
    """Do one job, or give Hydra's `main` what is its.

    The config of every job is checked before the first starts.

    Args:
        verb: Whose jobs they are.
        body: What a job does.
        options: Of the command line.
        typed: The command line, for `command.txt`.

    Raises:
        ConfigError: Wrong flags, or mistakes in the config of any job: nothing has started.
    """
    from embodichain.config.composed import compose
    from embodichain.config.hydra_loader import user_configs

    overrides = [*split_overrides(options.words), *job_options(options)]
    if options.gym_config is not None:
        from embodichain.config.gym_config import override_of

        overrides.append(override_of(options.gym_config))
    prints = options.cfg is not None or options.info is not None
    hydras = any(line.lstrip("+~").startswith(("hydra.", "hydra/")) for line in overrides)
    resumes = any(line.lstrip("+").startswith("resume=") for line in overrides)
    with user_configs(options.config_dir):
        if verb == "train" and resumes:
            from embodichain.cli.resuming import resolve_resumed

            if options.multirun or prints or hydras:
                raise ConfigError(
                    "resume goes on with one training: no --multirun, no key of Hydra's"
                )
            execute(resolve_resumed(overrides), body, typed)
        elif prints or options.multirun or hydras:
            from embodichain.cli.sweeping import call_hydra

            call_hydra(verb, body, options, overrides, typed)
        else:
            execute(resolved_job(compose(overrides, verb), verb), body, typed)
