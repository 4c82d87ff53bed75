"""`embodichain validate`: every mistake in a task or a file, found without running anything."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json, split_overrides
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.derive import Verb
    from embodichain.config.problems import LocatedProblem

__all__ = ["main"]


def main(arguments: list[str]) -> int:
    """Print every mistake on stderr and exit 2, or say that there is none."""
    parser = VerbParser(VERBS["validate"])
    parser.add_argument("overrides", nargs="*", metavar="FILE|key=value")
    parser.add_argument("--train", action="store_true", help="as `train` would read it")
    add_common(parser, config_dir=True)
    options = parser.parse(arguments)
    words = options.overrides
    from embodichain.config.composed import compose
    from embodichain.config.validation import validate

    verb: Verb = "train" if options.train else "run"
    notes: tuple[LocatedProblem, ...] = ()
    files = [word for word in words if _is_file(word)]
    if files:
        if len(words) > 1:
            raise ConfigError(f"either one file or overrides: {' '.join(words)}")
        from embodichain.config.file_validation import notes_on_file, validate_file

        name, problems = files[0], validate_file(Path(files[0]), verb)
        notes = notes_on_file(files[0])
    else:
        if not words:
            raise ConfigError("validate what? task=NAME or a file: `embodichain list tasks`")
        name = " ".join(words)
        composed = compose(split_overrides(words), verb, config_dir=options.config_dir)
        problems, notes = validate(composed, verb), composed.notes
    if options.json:
        mistakes = [p.as_dict() for p in problems]
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
