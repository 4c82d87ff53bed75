"""Checks before a study begins: its searches, and that its policies act in its tasks."""

from __future__ import annotations

from dataclasses import replace

from embodichain.cli.jobs.job import policy_of
from embodichain.cli.studies.study_job import StudyFolder, evaluation_stage
from embodichain.cli.sweeps.sweep_plan import needs_machine
from embodichain.cli.sweeps.sweeping import points
from embodichain.config.resolved import Resolved
from embodichain.config.study import Study, search_lines
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["check_policies", "check_searches"]


def check_searches(study: Study) -> None:
    """Check the searches of arms with the first value of each of their keys.

    Args:
        study: The study.

    Raises:
        ConfigError: Lists every mistake.
    """
    problems: dict[str, Problem] = {}
    for job in study.jobs():
        search = job.arm_cfg.optimize
        if search is None or job.seed != study.cfg.seeds[0]:
            continue
        path = f"arms.{job.arm}.optimize.params"
        lines = search_lines(search)
        try:
            (first,) = points(lines, 1)
            for line in set(first) & set(lines):
                message = f"{line} has one value: write interval(LOW, HIGH) or choice(A, B)"
                problems[line] = Problem(path, message)
            job.training(first)
        except ConfigError as error:
            for problem in error.problems:
                located = replace(problem, source=f"arm {job.arm}, task {job.task}; {path}")
                problems.setdefault(f"{job.arm} {problem.path} {problem.message}", located)
    if problems:
        raise ConfigError(list(problems.values()))


def check_policies(study: Study, place: StudyFolder) -> None:
    """Check that each arm's policy, or file of one, fits its tasks, by building them.

    What is done already is not checked again, nor what needs another machine than this.

    Args:
        study: The study.
        place: Its folder, which need not exist.

    Raises:
        ConfigError: Lists every policy that does not fit, for example as it was trained in another
            task.
    """
    problems: list[Problem] = []
    for job in study.jobs():
        if job.trains or job.seed != study.cfg.seeds[0]:
            continue
        variation = study.variations[0]
        try:
            stage = evaluation_stage(place, job, variation)
            if stage.why_it_runs() is not None and not needs_machine(stage.resolved):
                _load(stage.resolved)
        except ConfigError as error:
            source = f"arm {job.arm}, task {job.task}"
            for problem in error.problems:
                path = problem.path or f"arms.{job.arm}.policy"
                problems.append(replace(problem, path=path, source=problem.source or source))
    if problems:
        raise ConfigError(problems)


def _load(resolved: Resolved) -> None:
    """Build an environment of a config, and load its policy for it."""
    from embodichain.config.environments.factory import make_env

    env = make_env(resolved.changed(num_envs=1, record={"format": "none"}))
    try:
        policy_of(resolved.root, env)
    finally:
        env.close()
