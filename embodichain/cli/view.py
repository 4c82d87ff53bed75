"""`embodichain view`: how to look at a log in a viewer; open it there, or play it to one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from embodichain.cli.app import common, log_argument, log_of, verb
from embodichain.cli.output import print_json, say_warnings
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.recording.summary import LogSummary

__all__ = ["command"]

_LAYOUT = "foxglove_layout.json"
_MAGIC = b"\x89MCAP0\r\n"
"""The first and last bytes of a complete MCAP file."""


@verb(
    "view",
    ("view last", "the newest run's log, and the layout beside it"),
    ("view outputs/latest --open", "with the program that the desktop has for it"),
    ("view last --serve", "play it at ws://127.0.0.1:8765, also a broken one"),
)
@log_argument()
@click.option("--open", "opens", is_flag=True, help="Open it with the desktop's program.")
@click.option("--serve", is_flag=True, help="Play it over a WebSocket.")
@click.option("--host", default="127.0.0.1", help="Of --serve.")
@click.option("--port", type=int, metavar="N", help="Of --serve; 8765.")
@click.option("--speed", type=float, default=1.0, metavar="X", help="Of --serve; 1.")
@common()
def command(
    file: str,
    opens: bool,
    serve: bool,
    host: str,
    port: int | None,
    speed: float,
    json: bool,
    traceback: bool,
) -> None:
    """Say how a log is opened; open or play it if asked to."""
    if not speed > 0:
        raise ConfigError("--speed must be above 0")
    from embodichain.recording import inspect

    log = inspect(log_of(file))
    say_warnings(log.path, log.warnings)
    layout = _layout(log)
    if json:
        print_json({"file": str(log.path), "layout": str(layout), "complete": log.complete})
    else:
        sys.stdout.write(_told(log, layout))
    if serve:
        _serve(log.path, host, port, speed)
    elif opens:
        _open(log)


def _told(log: LogSummary, layout: Path) -> str:
    """Two lines: what to open, and how it is laid out."""
    files = [log.path.with_name(name) for name in log.files]
    if all(_has_end(file) for file in files):
        first = f"Foxglove or Lichtblick: Open local file, {', '.join(map(str, files))}"
    else:  # both insist on the index at a file's end
        saved = log.path.with_name(f"{log.path.stem}_saved.mcap")
        first = f"embodichain recover {log.path} {saved}, and Open local file, {saved}, in Foxglove"
        first += " or Lichtblick"
    return f"{first}\nthen Layouts, Import from file, {layout}\n"


def _has_end(file: Path) -> bool:
    with file.open("rb") as stream:
        stream.seek(-len(_MAGIC), os.SEEK_END)
        return stream.read() == _MAGIC


def _layout(log: LogSummary) -> Path:
    """The layout beside the log; taken from its attachment where it is not there."""
    path = log.path.with_name(_LAYOUT)
    if not path.exists():
        from embodichain.recording.chunks import LogReader

        with LogReader(log.path) as reader:
            if _LAYOUT in reader.attachments:
                path.write_bytes(reader.attachment(_LAYOUT))
    return path


def _open(log: LogSummary) -> None:
    """Hand the file to the desktop."""
    for name in ("xdg-open", "open"):
        program = shutil.which(name)
        if program is not None:
            subprocess.run([program, str(log.path)], check=False)
            return
    raise ConfigError("there is no xdg-open here, so no desktop that could open a file")


def _serve(path: Path, host: str, port: int | None, speed: float) -> None:
    """Play until Ctrl-C."""
    from embodichain.cli.attach import warn_if_public
    from embodichain.cli.process import StopFlag
    from embodichain.recording.viewers.foxglove import FoxgloveServer, declare_channels, stream_log

    server = FoxgloveServer(host, port)
    try:
        declare_channels(path, server)
        sys.stdout.write(f"playing it at {server.url}: Open connection; Ctrl-C ends it\n")
        sys.stdout.flush()
        warn_if_public(host, server.url, controls=False)
        with StopFlag() as stop:
            stream_log(path, server, stop.is_stopped, speed)
    finally:
        server.close()
