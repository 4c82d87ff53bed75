"""`embodichain diff A B`: the first step and field in which two logs differ."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass

from embodichain.cli.terminal import process
from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import log_argument, verb
from embodichain.cli.words import log_of

__all__ = ["command"]


@dataclass(frozen=True)
class DiffOptions:
    """What was typed after `diff`.

    Attributes:
        a: The first log, its folder, or ``last``.
        b: The second one.
        json: Print the result as one JSON object.
    """

    a: str
    b: str
    json: bool


@verb(
    "diff",
    ("diff outputs/A outputs/B", "two runs; exits 0 if they are the same, 1 if not"),
    ("diff old.mcap new.mcap --json", "for scripts"),
    options=DiffOptions,
)
@log_argument("A", "a")
@log_argument("B", "b")
def command(options: DiffOptions) -> int:
    """Compare two logs; the exit code is 1 if they differ."""
    from embodichain.recording.check.log_diff import diff

    report = diff(log_of(options.a), log_of(options.b))
    if options.json:
        print_json({**asdict(report), "same": report.same})
    else:
        for note in report.notes:
            sys.stderr.write(f"note: {note}\n")
        if report.difference is None:
            sys.stdout.write(f"the same: {report.steps} control steps, every bit\n")
        else:
            sys.stdout.write(f"they differ first at {report.difference}\n")
    return process.OK if report.same else process.FAILED
