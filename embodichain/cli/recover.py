"""`embodichain recover`: a clean log from a broken one, which stays as it is."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.log_files import log_of
from embodichain.cli.verbs import VERBS

if TYPE_CHECKING:
    from embodichain.recording.recover import Recovery

__all__ = ["main"]


def main(arguments: list[str]) -> int:
    """Write what can be read of IN to OUT, and say where it ends."""
    parser = VerbParser(VERBS["recover"])
    parser.add_argument("source", metavar="IN", help="a log, a run's folder, or `last`")
    parser.add_argument("target", metavar="OUT", help="a new file")
    parser.add_argument("--quiet", "-q", action="store_true", help="no report")
    add_common(parser)
    options = parser.parse(arguments)
    from embodichain.recording.recover import recover

    saved = recover(log_of(options.source), Path(options.target))
    if options.json:
        print_json(asdict(saved))
    elif not options.quiet:
        sys.stdout.write(_told(saved))
    return exits.OK


def _told(saved: Recovery) -> str:
    what = f"{saved.steps} control steps, {saved.messages} messages, {saved.nbytes / 1e6:.2f} MB"
    if not saved.damage:
        return f"{saved.source} is whole; copied to {saved.path}: {what}\n"
    lost = f" ({saved.lost_bytes} bytes behind it were not readable)" if saved.lost_bytes else ""
    end = f"after step {saved.steps - 1}" if saved.steps else "before its first step was complete"
    return f"recovered {saved.path}: {what}\nthe log ends {end}: {saved.damage}{lost}\n"
