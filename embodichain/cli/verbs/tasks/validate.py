"""`embodichain validate`: prints every mistake in a task or a file that `run` would refuse.

One environment is built as a run builds it, which needs torch. Where a part of the config is wrong,
the rest is built, so that all mistakes are found in one round.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.jobs.job import check_extras, check_job, pin_last
from embodichain.cli.jobs.unread_keys import verb_of_keys
from embodichain.cli.jobs.work.demonstrations import first_episode
from embodichain.cli.terminal import process
from embodichain.cli.terminal.output import print_json
from embodichain.cli.terminal.reporting import warnings_on_stderr
from embodichain.cli.verb import overrides, verb
from embodichain.cli.words import split_overrides
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.keys.schema import JobVerb
    from embodichain.config.resolved import Checked, Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.compiler.compile_scene import CompiledScene

__all__ = ["command"]


@dataclass(frozen=True)
class ValidateOptions:
    """What was typed after `validate`.

    Attributes:
        words: A file, or overrides.
        train: Check the config as `train` would read it.
        collect: Check it as `collect` would.
        json: Print the result as one JSON object.
    """

    words: tuple[str, ...]
    train: bool
    collect: bool
    json: bool


@verb(
    "validate",
    ("validate task=reach", "a task that ships with embodichain"),
    ("validate --train task=reach algo=sac", "as `train` would read it"),
    ("validate --collect task=pick_place", "as `collect` would"),
    ("validate task=reach task.max_episode_steps=50", "with overrides"),
    ("validate --config-dir my_conf task=random_reach", "with your folder"),
    options=ValidateOptions,
    keys=True,
    config_dir=True,
)
@overrides("FILE | [task=NAME] [KEY=VALUE]...")
@click.option("--train", is_flag=True, help="As `train` would read it.")
@click.option("--collect", is_flag=True, help="As `collect` would read it.")
def command(options: ValidateOptions) -> int:
    """Print every mistake on stderr and exit with 2, or report that there is none."""
    if options.train and options.collect:
        raise ConfigError("either --train or --collect")
    name = " ".join(options.words)
    is_file = any(_is_file_name(word) for word in options.words)
    if is_file and len(options.words) > 1:
        raise ConfigError(f"either one file or overrides: {name}")
    if not options.words:
        raise ConfigError("validate what? task=NAME or a file: `embodichain list tasks`")
    # A composition has notes even if a check ends with an error.
    notes: list[Problem] = []
    problems: tuple[Problem, ...] = ()
    config: Checked | None = None
    try:
        if is_file and _is_of_study(name):
            problems = _study_mistakes(name)
        elif is_file:
            config = _check_file(name, _verb(options) or "run", notes)
        else:
            config = _check_overrides(split_overrides(options.words), _verb(options), notes)
        if config is not None:
            further_notes, problems = _find_mistakes(config, notes)
            notes += further_notes
    except ConfigError as error:
        problems = error.problems
    if options.json:
        facts: dict[str, Any] = {
            "checked": name,
            "ok": not problems,
            "mistakes": [asdict(problem.at(problem.source)) for problem in problems],
        }
        if notes:
            facts["notes"] = [asdict(note) for note in notes]
        print_json(facts)
        return process.WRONG_INPUT if problems else process.OK
    for note in notes:
        sys.stderr.write(f"note: {note}\n")
    if problems:
        raise ConfigError(problems)
    sys.stdout.write(f"{name}: ok\n")
    return process.OK


def _verb(options: ValidateOptions) -> JobVerb | None:
    """The verb whose config was asked for; None without an option."""
    if options.train:
        return "train"
    if options.collect:
        return "collect"
    return None


def _is_file_name(word: str) -> bool:
    """Whether a word names a file: by its suffix, so that a missing file is reported as missing."""
    return "=" not in word and word.endswith((".yaml", ".yml", ".json"))


def _is_of_study(name: str) -> bool:
    from embodichain.config.file_validation import is_of_study

    return is_of_study(name)


def _study_mistakes(name: str) -> tuple[Problem, ...]:
    """The mistakes in the file of a study or a suite, which is not built."""
    from embodichain.config.file_validation import validate_file

    return tuple(validate_file(name))


def _check_file(name: str, verb: JobVerb, notes: list[Problem]) -> Checked:
    """Check a file, and add notes about it to a list."""
    from embodichain.config.file_validation import checked_file, notes_on_file

    notes += notes_on_file(name)
    return checked_file(name, verb)


def _check_overrides(lines: list[str], verb: JobVerb | None, notes: list[Problem]) -> Checked:
    """Check a composed config, and add notes about it to a list.

    Args:
        lines: The overrides.
        verb: The verb that must read their keys; None takes keys of every verb.
        notes: The list.
    """
    from embodichain.config.composition.composed import compose

    job_verb = verb or verb_of_keys(lines)
    composed = compose(lines, job_verb)
    notes += composed.notes
    return check_job(composed, job_verb, any_key=verb is None)


def _find_mistakes(
    config: Checked, before: Sequence[Problem]
) -> tuple[list[Problem], tuple[Problem, ...]]:
    """Check a config as far as a job of it can be, also where a part of it has mistakes.

    Args:
        config: The checked config.
        before: The notes so far.

    Returns:
        Further notes; and every mistake: of the config, of packages that it needs, of its building.

    Raises:
        Exception: Any other error that would end the job.
    """
    from embodichain.config.environments.factory import with_warp_values
    from embodichain.config.resolved import compile_scene_of
    from embodichain.config.sound_part import further_mistakes

    notes: list[Problem] = []
    problems = list(config.check.problems)
    root = config.check.types.root
    if problems and root is not None:
        with _collect_mistakes(problems, config.locating):
            check_extras(root)
        roots = {problem.path.partition(".")[0] for problem in problems}
        if config.verb == "train" and roots == {"task"}:
            from embodichain.learning.training.train import check_training

            rest = replace(config, check=replace(config.check, problems=[]))
            with _collect_mistakes(problems, config.locating):
                check_training(rest.resolved())
    elif not problems:
        with warnings_on_stderr():
            resolved = pin_last(config.resolved())
            notes += [note for note in resolved.notes if note not in before]
            with _collect_mistakes(problems, resolved.locating):
                if config.verb == "train":
                    from embodichain.learning.training.train import check_training

                    check_training(resolved)
            with _collect_mistakes(problems, resolved.locating):
                check_extras(resolved.root)
            with _collect_mistakes(problems, resolved.locating):
                scene = compile_scene_of(resolved)
                num_notes = len(resolved.notes)
                resolved = with_warp_values(resolved, config.verb, compiled_scene=scene)
                notes += resolved.notes[num_notes:]
                notes += _try_out(resolved, scene, config.verb, complete=not problems)
    if problems:
        problems += further_mistakes(config, problems, _build)
    return notes, tuple(problems)


@contextmanager
def _collect_mistakes(
    problems: list[Problem], locating: Callable[[], AbstractContextManager[None]]
) -> Iterator[None]:
    """Add the mistakes that are raised inside the context, with their places, to a list."""
    try:
        with locating():
            yield
    except ConfigError as error:
        problems += [problem for problem in error.problems if problem not in problems]


def _build(resolved: Resolved) -> None:
    """Build the environment of a config, which evaluates each term once."""
    from embodichain.config.environments.factory import make_env

    with tempfile.TemporaryDirectory() as folder:
        make_env(resolved, run_dir=Path(folder)).close()


def _try_out(
    resolved: Resolved, compiled_scene: CompiledScene | None, verb: JobVerb, *, complete: bool
) -> list[Problem]:
    """Build what the job builds, reset it and take one step.

    Terms write files into a temporary folder, which is removed; no viewer is opened and no log is
    written.

    Args:
        resolved: A checked config.
        compiled_scene: Its scene.
        verb: ``train`` also builds the algorithm, ``run`` and ``collect`` the policy.
        complete: Whether nothing is wrong so far; else only the environment is built.

    Returns:
        Links of robots that overlap in many postures, one note for each robot; and what is odd
        about the first steps with zero actions.

    Raises:
        ConfigError: A mistake that the job would refuse, with its place.
        Exception: Any other error that would end the job.
    """
    from embodichain.cli.jobs.job import policy_name, policy_of
    from embodichain.config.environments.factory import make_env

    unseen = resolved.changed(viewer={**resolved.tree["viewer"], "name": "none"})
    root = resolved.root
    with tempfile.TemporaryDirectory() as folder, resolved.locating():
        env = make_env(unseen, compiled_scene=compiled_scene, run_dir=Path(folder))
        try:
            if not complete:
                return []
            if verb == "train":
                from embodichain.learning.training.train import check_algorithm, check_episode

                check_algorithm(resolved, env)
                if root.dataset is not None:
                    check_episode(resolved, env, first_episode(root, env))
                return [*_overlaps(env), *_try_zero_actions(resolved, env)]
            if root.record.images is not None:
                from embodichain.recording import ImageOptions
                from embodichain.recording.views.images import image_topics

                image_topics(env, ImageOptions(**vars(root.record.images)))
            policy = policy_of(root, env)
            if policy_name(root) == "teleop":
                from embodichain.lab.gym.teleop import IdleOperator, Teleop

                if isinstance(policy, Teleop):
                    policy.operator = IdleOperator()
            obs, _ = env.reset()
            env.step(policy(obs, env))
            return [*_overlaps(env), *_try_zero_actions(resolved, env)]
        finally:
            env.close()


def _try_zero_actions(resolved: Resolved, env: BaseEnv) -> list[Problem]:
    """Judge a few steps with zero actions, where their results are on the host."""
    from embodichain.config.checks.trial import try_zero_actions

    if env.arrays.on_device:
        return []
    return [note.at(resolved.source(note.path)) for note in try_zero_actions(env)]


def _overlaps(env: BaseEnv) -> list[Problem]:
    """Return a note for each robot with links that overlap in many postures."""
    from embodichain.lab.sim.compiler.robot.overlaps import overlapping_links

    notes: list[Problem] = []
    for uid, asset in {**env.sim.robots, **env.sim.articulations}.items():
        shares = overlapping_links(asset.parsed)
        if not shares:
            continue
        pairs = ", ".join(f"{a} and {b} {share:.0%}" for (a, b), share in shares.items())
        fact = f"links that are in each other in many of 200 postures: {pairs}"
        advice = "self_collision.exclude leaves pairs out, include says that they are meant"
        notes.append(Problem(uid, f"{fact}; {advice}"))
    return notes
