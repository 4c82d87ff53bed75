"""`embodichain recover`: writes a clean log from a broken one, which is not changed."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import log_argument, verb
from embodichain.cli.words import log_of

if TYPE_CHECKING:
    from embodichain.recording.read.recover import Recovery

__all__ = ["command"]


@dataclass(frozen=True)
class RecoverOptions:
    """What was typed after `recover`.

    Attributes:
        file: The broken log, its folder, or ``last``.
        target: Path of the new log.
        quiet: Print no progress and no report.
        json: Print the result as one JSON object.
    """

    file: str
    target: str
    quiet: bool
    json: bool


@verb(
    "recover",
    ("recover last saved.mcap", "the newest run's log; it is only read"),
    ("recover broken.mcap saved.mcap --json", "what was saved, for scripts"),
    options=RecoverOptions,
    quiet=True,
)
@log_argument("IN")
@click.argument("target", metavar="OUT")
def command(options: RecoverOptions) -> None:
    """Write the readable part of IN to OUT, and report where it ends."""
    from embodichain.recording.read.recover import recover

    saved = recover(log_of(options.file), Path(options.target))
    if options.json:
        print_json(asdict(saved))
    elif not options.quiet:
        sys.stdout.write(_told(saved))


def _told(saved: Recovery) -> str:
    what = f"{saved.steps} control steps, {saved.messages} messages, {saved.nbytes / 1e6:.2f} MB"
    if not saved.damage:
        return f"{saved.source} is whole; copied to {saved.path}: {what}\n"
    lost = f" ({saved.lost_bytes} bytes behind it were not readable)" if saved.lost_bytes else ""
    end = f"after step {saved.steps - 1}" if saved.steps else "before its first step was complete"
    return f"recovered {saved.path}: {what}\nthe log ends {end}: {saved.damage}{lost}\n"
