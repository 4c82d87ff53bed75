"""`embodichain recover`: writes a clean log from a broken one, which is not changed."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import log_argument, verb
from embodichain.cli.words import STILL_GOING, is_still_written, log_of

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
    ("recover broken.mcap saved.mcap --json", "what was saved, as JSON"),
    options=RecoverOptions,
    quiet=True,
)
@log_argument("IN")
@click.argument("target", metavar="OUT")
def command(options: RecoverOptions) -> None:
    """Write the readable part of IN to OUT, and report where it ends."""
    from embodichain.recording.read.recover import recover

    recovery = recover(log_of(options.file), Path(options.target))
    if options.json:
        print_json(asdict(recovery))
    elif not options.quiet:
        sys.stdout.write(f"{_describe(recovery)}\n")


def _describe(recovery: Recovery) -> str:
    """What was saved, and where and why the log ends."""
    megabytes = recovery.nbytes / 1e6
    contents = f"{recovery.steps} control steps, {recovery.messages} messages, {megabytes:.2f} MB"
    if not recovery.damage:
        return f"{recovery.source} is complete; copied to {recovery.path}: {contents}"
    end = "before its first step was complete"
    if recovery.steps:
        end = f"after step {recovery.steps - 1}"
    damage = recovery.damage
    if is_still_written(recovery.source):
        return f"recovered {recovery.path}: {contents}\nthe log ends {end}: {STILL_GOING}"
    if recovery.lost_bytes:
        damage += f" ({recovery.lost_bytes} bytes after it are not readable)"
    return f"recovered {recovery.path}: {contents}\nthe log ends {end}: {damage}"
