"""`embodichain validate`: every mistake in a task or a file that `run` would refuse.

What the config alone shows comes first, all of it at once; then one environment is built as a run
builds it, which needs torch.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from embodichain.cli import exits
from embodichain.cli.app import common, overrides, split_overrides, verb
from embodichain.cli.jobs import Verb, resolved_job
from embodichain.cli.logs import warnings_on_stderr
from embodichain.cli.output import print_json
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = ["command", "try_out"]


@verb(
    "validate",
    ("validate task=reach", "a task that ships with embodichain"),
    ("validate --train task=reach algo=sac", "as `train` would read it"),
    ("validate task=reach task.max_episode_steps=50", "with overrides"),
    ("validate --config-dir my_conf task=random_reach", "with a folder of yours"),
    keys=True,
)
@overrides("FILE | [task=NAME] [KEY=VALUE]...")
@click.option("--train", is_flag=True, help="As `train` would read it.")
@common(config_dir=True)
def command(
    words: tuple[str, ...], train: bool, config_dir: str | None, json: bool, traceback: bool
) -> int:
    """Print every mistake on stderr and exit 2, or say that there is none."""
    verb: Verb = "train" if train else "run"
    name = " ".join(words)
    files = [word for word in words if _is_file(word)]
    notes: tuple[Problem, ...] = ()
    problems: tuple[Problem, ...] = ()
    if files and len(words) > 1:
        raise ConfigError(f"either one file or overrides: {name}")
    if not words:
        raise ConfigError("validate what? task=NAME or a file: `embodichain list tasks`")
    try:
        if files:
            from embodichain.config.file_validation import notes_on_file, resolve_file

            notes = notes_on_file(name)
            resolved = resolve_file(name, verb)
        else:
            from embodichain.config.composed import compose

            composed = compose(split_overrides(words), verb, config_dir=config_dir)
            notes = composed.notes
            resolved = resolved_job(composed, verb)
        notes = resolved.notes
        with warnings_on_stderr():
            try_out(resolved, verb)
    except ConfigError as error:
        problems = error.problems
    if json:
        mistakes = [asdict(p.at(p.source)) for p in problems]
        listed = {"notes": [asdict(p) for p in notes]} if notes else {}
        print_json({"checked": name, "ok": not problems, "mistakes": mistakes, **listed})
        return exits.WRONG_INPUT if problems else exits.OK
    for note in notes:
        sys.stderr.write(f"note: {note}\n")
    if problems:
        raise ConfigError(problems)
    sys.stdout.write(f"{name}: ok\n")
    return exits.OK


def _is_file(word: str) -> bool:
    """Whether a word means a file: by its ending, so that a missing one is reported as such."""
    return "=" not in word and word.endswith((".yaml", ".yml", ".json"))


def try_out(resolved: Resolved, verb: Verb) -> None:
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
    from embodichain.cli.attach import check_attachments, policy_of
    from embodichain.config.factory import make_env

    unseen = resolved.changed(viewer={**resolved.tree["viewer"], "name": "none"})
    root = resolved.root
    with tempfile.TemporaryDirectory() as folder, resolved.locating():
        check_attachments(root)
        env = make_env(unseen, run_dir=Path(folder))
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
