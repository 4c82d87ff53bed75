"""`embodichain view`: how to look at a log in a viewer; open it there, or play it to one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.log_files import log_of
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.recording.summary import LogSummary

__all__ = ["main"]

_LAYOUT = "foxglove_layout.json"
_MAGIC = b"\x89MCAP0\r\n"
"""The first and last bytes of a complete MCAP file."""


def main(arguments: list[str]) -> int:
    """Say how a log is opened; open or play it if asked to."""
    parser = VerbParser(VERBS["view"])
    parser.add_argument("file", metavar="FILE", help="a log, a run's folder, or `last`")
    parser.add_argument("--open", action="store_true", help="open it with the desktop's program")
    parser.add_argument("--serve", action="store_true", help="play it over a WebSocket")
    parser.add_argument("--host", default="127.0.0.1", help="of --serve")
    parser.add_argument("--port", type=int, metavar="N", help="of --serve; 8765")
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="of --serve; 1")
    add_common(parser)
    options = parser.parse(arguments)
    if not options.speed > 0:
        raise ConfigError("--speed must be above 0")
    path = log_of(options.file)
    from embodichain.recording import inspect

    log = inspect(path)
    for warning in log.warnings:
        sys.stderr.write(f"warning: {log.path}: {warning}\n")
    layout = _layout(log)
    if options.json:
        print_json({"file": str(log.path), "layout": str(layout), "complete": log.complete})
    else:
        sys.stdout.write(_told(log, layout))
    if options.serve:
        _serve(log.path, options.host, options.port, options.speed)
    elif options.open:
        _open(log)
    return exits.OK


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
    from embodichain.cli.stopping import StopFlag
    from embodichain.recording.viewers.foxglove_playback import declare_channels, play_log
    from embodichain.recording.viewers.foxglove_server import DEFAULT_PORT, FoxgloveServer
    from embodichain.utils.addresses import is_loopback

    server = FoxgloveServer(host, DEFAULT_PORT if port is None else port)
    try:
        declare_channels(path, server)
        sys.stdout.write(f"playing it at {server.url}: Open connection; Ctrl-C ends it\n")
        sys.stdout.flush()
        if not is_loopback(host):
            sys.stderr.write(f"warning: everybody who reaches {host} can look at it\n")
        with StopFlag() as stop:
            play_log(path, server, lambda: stop.stopped is not None, speed=speed)
    finally:
        server.close()
