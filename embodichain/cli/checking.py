"""What `run` and `train` check of a job before it begins, and `validate` with them.

`resolved_job` reads the config alone, without torch. `try_out` finds what only building shows, by
building: constructors of terms, values of Python functions, a policy that does not fit.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from embodichain.config.composed import Composed
    from embodichain.config.resolved import Resolved

__all__ = ["resolved_job", "try_out"]


def resolved_job(composed: Composed, verb: Literal["run", "train"]) -> Resolved:
    """Check a job's config as a whole; for a training, what its algorithm takes too.

    Args:
        composed: What `compose` returned.
        verb: Whose job it is.

    Raises:
        ConfigError: Every mistake, with its place.
    """
    from embodichain.config.resolved import resolve

    resolved = resolve(composed, verb)
    if verb == "train":
        from embodichain.learning.train import check_training

        with resolved.locating():
            check_training(resolved)
    return resolved


def try_out(resolved: Resolved, verb: Literal["run", "train"]) -> None:
    """Build what the job builds, reset it and take one step.

    Files that terms write go to a temporary folder, which is removed; no viewer is opened and no
    log is written.

    Args:
        resolved: A config that was checked.
        verb: Whose job it is: a training builds its algorithm, a run its policy.

    Raises:
        ConfigError: What the job would refuse, with its place.
        Exception: What else would end the job here.
    """
    from embodichain.cli.filming import check_film
    from embodichain.cli.jobs import Job
    from embodichain.cli.policies import policy_of
    from embodichain.cli.viewing import check_viewer
    from embodichain.config.factory import make_env
    from embodichain.config.frozen import freeze

    unseen = {**resolved.tree["viewer"], "name": "none"}
    quiet = replace(resolved, tree=freeze({**resolved.tree, "viewer": unseen}))
    root = resolved.root
    with tempfile.TemporaryDirectory() as folder, resolved.locating():
        check_film(Job(resolved, root, Path(folder)))
        check_viewer(root)
        env = make_env(quiet, run_dir=Path(folder))
        try:
            if verb == "train":
                from embodichain.learning.train import check_algorithm

                check_algorithm(resolved, env)
                return
            policy = policy_of(root, env)
            obs, _ = env.reset()
            env.step(policy(obs, env))
        finally:
            env.close()
