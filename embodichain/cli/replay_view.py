"""`embodichain replay FILE --view`: a log in a window, or on a page in the browser."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser
from embodichain.cli.stopping import StopFlag
from embodichain.cli.viewing import warn_of_address
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.recording.api import Log
    from embodichain.recording.viewers.log_screens import Screen

__all__ = ["add_arguments", "view"]

VIEWERS = ("native", "web")


def add_arguments(parser: VerbParser) -> None:
    """The options that only viewers have."""
    parser.add_argument(
        "--view",
        nargs="?",
        const="",
        metavar="WHERE",
        help="play it in a window (native) or a browser (web); else native where a display is",
    )
    parser.add_argument("--host", metavar="H", help="what --view web listens on; else 127.0.0.1")
    parser.add_argument("--port", type=int, metavar="P", help="its port; else a free one from 8080")


def view(path: Path, options: argparse.Namespace) -> int:
    """Play until the window is closed or somebody presses Ctrl-C."""
    from embodichain.recording.api import Log
    from embodichain.recording.playback import span_of
    from embodichain.recording.viewers.log_player import play_log

    speed = 1.0 if options.speed is None else options.speed
    if not (math.isfinite(speed) and speed > 0):
        raise ConfigError(f"--speed must be positive, got {speed}")
    last = None if options.stop is None else options.stop - 1
    with StopFlag() as stop, Log(path) as log:
        span_of(log, options.env or 0, options.episode, options.start, last)  # complains early
        for warning in log.warnings:
            sys.stderr.write(f"warning: {log.path}: {warning}\n")
        screen = _screen(log, options, stop)
        try:
            part = options.episode, options.start, last
            play_log(log, screen, *part, speed, lambda: stop.stopped is not None)
        finally:
            screen.close()
    return exits.OK


def _screen(log: Log, options: argparse.Namespace, stop: StopFlag) -> Screen:
    from embodichain.lab.sim.viewer import has_display
    from embodichain.recording.viewers.log_screens import NativeScreen

    name, env = options.view or ("native" if has_display() else "web"), options.env or 0
    if name == "foxglove":
        raise ConfigError("Foxglove and Lichtblick play the file itself: embodichain view FILE")
    if name not in VIEWERS:
        raise ConfigError(f"--view {name}: there are {', '.join(VIEWERS)}")
    if name == "native":
        if options.host is not None or options.port is not None:
            raise ConfigError("--host and --port are for --view web")
        return NativeScreen(env, lambda: stop.stopped is not None)
    from embodichain.recording.viewers.web_page import WebPage

    host = options.host or "127.0.0.1"
    page = WebPage(
        log.model,
        host,
        options.port,
        title=f"{log.task}: {log.path.name}",
        num_envs=log.num_envs,
        env_id=env,
        resets=False,
        stopped=lambda: stop.stopped is not None,
    )
    if not options.quiet:
        sys.stderr.write(f"viewer: {page.url} (Ctrl-C ends)\n")
        sys.stderr.flush()
    warn_of_address(host)
    return page
