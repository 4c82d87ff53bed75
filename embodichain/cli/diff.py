"""`embodichain diff A B`: the first step and field where two logs part."""

from __future__ import annotations

import sys
from dataclasses import asdict

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.log_files import log_of
from embodichain.cli.verbs import VERBS

__all__ = ["main"]


def main(arguments: list[str]) -> int:
    """Compare two logs; 1 if they differ."""
    parser = VerbParser(VERBS["diff"])
    parser.add_argument("a", metavar="A", help="a log, a run's folder, or `last`")
    parser.add_argument("b", metavar="B", help="another one")
    add_common(parser)
    options = parser.parse(arguments)
    from embodichain.recording.log_diff import diff

    report = diff(log_of(options.a), log_of(options.b))
    if options.json:
        print_json({**asdict(report), "same": report.same})
    else:
        for note in report.notes:
            sys.stderr.write(f"note: {note}\n")
        said = f"the same: {report.steps} control steps, every bit"
        if report.difference is not None:
            said = f"they differ first at {report.difference}"
        sys.stdout.write(f"{said}\n")
    return exits.OK if report.same else exits.FAILED
