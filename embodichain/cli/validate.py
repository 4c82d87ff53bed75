"""`embodichain validate`: every mistake in a task or a file that `run` would refuse.

What the config alone shows comes first, all of it at once; then one environment is built as a run
builds it, which needs torch.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json, split_overrides
from embodichain.cli.checking import resolved_job, try_out
from embodichain.cli.logs import warnings_on_stderr
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.derive import Verb

__all__ = ["main"]


def main(arguments: list[str]) -> int:
    """Print every mistake on stderr and exit 2, or say that there is none."""
    parser = VerbParser(VERBS["validate"])
    parser.add_argument("overrides", nargs="*", metavar="FILE|key=value")
    parser.add_argument("--train", action="store_true", help="as `train` would read it")
    add_common(parser, config_dir=True)
    options = parser.parse(arguments)
    words = options.overrides
    from embodichain.config.problems import LocatedProblem

    verb: Verb = "train" if options.train else "run"
    name = " ".join(words)
    files = [word for word in words if _is_file(word)]
    notes: tuple[LocatedProblem, ...] = ()
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

            composed = compose(split_overrides(words), verb, config_dir=options.config_dir)
            notes = composed.notes
            resolved = resolved_job(composed, verb)
        notes = resolved.notes
        with warnings_on_stderr():
            try_out(resolved, verb)
    except ConfigError as error:
        problems = error.problems
    if options.json:
        mistakes = [LocatedProblem.of(p, getattr(p, "source", "")).as_dict() for p in problems]
        listed = {"notes": [p.as_dict() for p in notes]} if notes else {}
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
