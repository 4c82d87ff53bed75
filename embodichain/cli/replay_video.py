"""`embodichain replay FILE --video OUT`: a film of one environment of a log."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, print_json
from embodichain.cli.exits import Interrupted
from embodichain.cli.filming import ended_early, shown
from embodichain.cli.stopping import StopFlag
from embodichain.utils.errors import ConfigError

__all__ = ["add_arguments", "film"]

_SIZE = re.compile(r"(\d{1,5})x(\d{1,5})\Z")


def add_arguments(parser: VerbParser) -> None:
    """The options that only films have."""
    parser.add_argument("--video", metavar="OUT", help="write an MP4 of --env, which is else 0")
    parser.add_argument("--camera", metavar="NAME", help="film with this camera of the scene")
    parser.add_argument("--size", metavar="WxH", help="pixels of the film; else 640x480")


def film(path: Path, options: argparse.Namespace) -> int:
    """Write the film, and say where it is."""
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.recording.api import Log
    from embodichain.recording.film import film_log

    quiet = options.quiet or options.json
    out = Path(options.video)
    last = None if options.stop is None else options.stop - 1
    speed = 1.0 if options.speed is None else options.speed
    size = _size(options.size) if options.size is not None else (640, 480)
    display = ProgressDisplay("film", None, "pictures", quiet=quiet)
    with Log(path) as log, StopFlag() as stop, display:
        part = options.env or 0, options.episode, options.start, last
        how = speed, size, options.camera
        filmed = film_log(log, out, *part, *how, shown(display), lambda: stop.stopped is not None)
        for warning in log.warnings:
            sys.stderr.write(f"warning: {log.path}: {warning}\n")
    if not filmed.pictures:
        raise Interrupted(ended_early(stop, filmed, out))
    nbytes = out.stat().st_size
    if options.json:
        facts = {"pictures": filmed.pictures, "bytes": nbytes, "complete": filmed.whole}
        print_json({"file": str(out), **facts})
    elif not options.quiet:
        sys.stdout.write(f"{out}: {filmed.pictures} pictures, {nbytes / 1e6:.2f} MB\n")
    if not filmed.whole:
        raise Interrupted(ended_early(stop, filmed, out))
    return exits.OK


def _size(text: str) -> tuple[int, int]:
    found = _SIZE.match(text)
    if found is None:
        raise ConfigError(f"--size is WIDTHxHEIGHT in pixels, such as 640x480, not {text!r}")
    return int(found[1]), int(found[2])
