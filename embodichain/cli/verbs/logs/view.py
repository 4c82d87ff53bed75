"""`embodichain view`: prints how to open a log in a viewer, opens it, or plays it to a viewer."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from embodichain.cli.jobs.access_options import AccessOptions, access_options, naming_flags
from embodichain.cli.terminal.output import print_json, say_warnings
from embodichain.cli.verb import log_argument, verb
from embodichain.cli.words import log_of, log_warnings
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.recording.read.summary import LogSummary

__all__ = ["command"]

_LAYOUT = "foxglove_layout.json"
_MAGIC = b"\x89MCAP0\r\n"
"""The first and last bytes of a complete MCAP file."""
_DESKTOP_PROGRAMS = ("xdg-open", "open")
"""Programs of Linux and macOS that open a file with the desktop's default program."""


@dataclass(frozen=True, kw_only=True)
class ViewOptions(AccessOptions):
    """What was typed after `view`.

    Attributes:
        file: The log, its folder, or ``last``.
        opens: Open it with the desktop's program.
        serve: Play it over a WebSocket.
        host: Address to serve at.
        port: Port to serve at; None is Foxglove's, 8765.
        speed: Speed of the served log; 1 is real time.
        json: Print the result as one JSON object.
    """

    file: str
    opens: bool
    serve: bool
    host: str
    port: int | None
    speed: float
    json: bool


@verb(
    "view",
    ("view last", "the newest run's log, and the layout beside it"),
    ("view outputs/latest --open", "with the program that the desktop has for it"),
    ("view last --serve", "play it at ws://127.0.0.1:8765, also a broken one"),
    options=ViewOptions,
)
@log_argument()
@click.option("--open", "opens", is_flag=True, help="Open it with the desktop's program.")
@click.option("--serve", is_flag=True, help="Play it over a WebSocket.")
@click.option("--host", default="127.0.0.1", help="Address of --serve. Default: 127.0.0.1.")
@click.option("--port", type=int, metavar="N", help="Port of --serve. Default: 8765.")
@access_options("--serve")
@click.option(
    "--speed",
    type=click.FloatRange(min=0, min_open=True),
    default=1.0,
    metavar="X",
    help="Speed of --serve; 1 is real time.",
)
def command(options: ViewOptions) -> None:
    """Print how to open a log, open it, or play it."""
    from embodichain.recording import inspect

    path = log_of(options.file)
    log = inspect(_choose_shard(path) or path)
    say_warnings(log.path, log_warnings(log))
    layout = _save_layout(log)
    if options.json:
        print_json({"file": str(log.path), "layout": str(layout), "complete": log.complete})
    else:
        sys.stdout.write(f"{_how_to_open(log)}\nthen Layouts, Import from file, {layout}\n")
    if options.serve:
        _serve(log.path, options)
    elif options.opens:
        _open_on_desktop(log)


def _how_to_open(log: LogSummary) -> str:
    """What to do to open a log in Foxglove or Lichtblick."""
    files = [log.path.with_name(name) for name in log.files]
    if all(map(_has_end, files)):
        return f"Foxglove or Lichtblick: Open local file, {', '.join(map(str, files))}"
    # Both programs need the index at a file's end, which `recover` writes.
    saved = log.path.with_name(f"{log.path.stem}_saved.mcap")
    return (
        f"embodichain recover {log.path} {saved}, and Open local file, {saved}, in Foxglove or "
        "Lichtblick"
    )


def _choose_shard(path: Path) -> Path | None:
    """Choose the log with the viewed environments, and print where the others are.

    Returns:
        Its path, or None if the log is not one of a batch in shards.
    """
    from embodichain.recording.shards.joining import shards_of

    manifest = shards_of(path)
    if manifest is None:
        return None
    from embodichain.recording.shards.sharded_log import ShardedLog

    with ShardedLog(manifest) as joined:
        viewed_env = next(iter(joined.header.view_envs), 0)
        shard, _ = joined.part_of(viewed_env)
        others = [log.path.name for log in joined.shards if log.path != shard.path]
    if others:
        sys.stderr.write(
            f"note: environment {viewed_env} is in {shard.path.name}; "
            f"the others are in {', '.join(others)}\n"
        )
    return shard.path


def _has_end(file: Path) -> bool:
    """Whether a file of a log ends as a complete MCAP file does."""
    with file.open("rb") as stream:
        stream.seek(-len(_MAGIC), os.SEEK_END)
        return stream.read() == _MAGIC


def _save_layout(log: LogSummary) -> Path:
    """Return the path of the layout beside the log; a missing one is written, if the log has it."""
    path = log.path.with_name(_LAYOUT)
    if not path.exists():
        from embodichain.recording.read.chunks import LogReader

        with LogReader(log.path) as reader:
            if _LAYOUT in reader.attachments:
                path.write_bytes(reader.attachment(_LAYOUT))
    return path


def _open_on_desktop(log: LogSummary) -> None:
    """Open the file with the desktop's default program."""
    for name in _DESKTOP_PROGRAMS:
        program = shutil.which(name)
        if program is not None:
            subprocess.run([program, str(log.path)], check=False)
            return
    raise ConfigError("there is no xdg-open here, so no desktop that could open a file")


def _serve(path: Path, options: ViewOptions) -> None:
    """Play the log to viewers that connect, until Ctrl-C."""
    from embodichain.cli.terminal.process import StopFlag
    from embodichain.cli.terminal.reporting import warn_if_public
    from embodichain.recording.viewers.foxglove import FoxgloveServer, declare_channels, stream_log

    with naming_flags():
        server = FoxgloveServer(options.host, options.port, options.access)
    try:
        declare_channels(path, server)
        sys.stdout.write(f"playing it at {server.url}: Open connection; Ctrl-C ends it\n")
        sys.stdout.flush()
        warn_if_public(options.host, server.url, controls=False)
        with StopFlag() as stop:
            stream_log(path, server, stop.is_stopped, options.speed)
    finally:
        server.close()
