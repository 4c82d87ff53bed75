"""`embodichain export FILE --format ...`: a log in the format that another program reads."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.exits import Interrupted
from embodichain.cli.filming import ended_early, shown
from embodichain.cli.log_files import log_of
from embodichain.cli.logs import warnings_on_stderr
from embodichain.cli.stopping import StopFlag
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.recording.api import Log
    from embodichain.recording.export.formats import Part

__all__ = ["main"]


def main(arguments: list[str]) -> int:
    """Write a log, or a part of it, to a new file."""
    parser = VerbParser(VERBS["export"])
    parser.add_argument("file", metavar="FILE", help="a log, a run's folder, or `last`")
    parser.add_argument(
        "--format",
        required=True,
        metavar="F",
        help="csv, npz, parquet, hdf5, lerobot, rrd, ros2 or mp4",
    )
    parser.add_argument("--output", "-o", metavar="OUT", help="a new file (lerobot: folder)")
    parser.add_argument("--env", type=int, metavar="I", help="only this environment")
    parser.add_argument("--episode", type=int, metavar="K", help="only this episode of --env")
    parser.add_argument("--from", dest="start", type=int, default=0, metavar="T", help="first step")
    parser.add_argument("--to", dest="stop", type=int, metavar="T", help="step that ends it")
    add_common(parser)
    options = parser.parse(arguments)
    from embodichain.recording.api import Log
    from embodichain.recording.export.formats import Part

    if options.episode is not None and options.env is None:
        raise ConfigError("--episode needs --env: episodes are counted in each environment")
    part = Part(options.env, options.episode, options.start, options.stop)
    with warnings_on_stderr(), Log(log_of(options.file), simulate=True) as log:
        export = _film if options.format == "mp4" else _write
        path, ended = export(log, options, part)
        for warning in log.warnings:
            sys.stderr.write(f"warning: {log.path}: {warning}\n")
        if options.json:
            print_json({"file": str(path), "bytes": _size(path), "complete": log.complete})
        else:
            sys.stdout.write(f"{path}: {_size(path) / 1e6:.2f} MB\n")
    if ended:
        raise Interrupted(ended)
    return exits.OK


def _write(log: Log, options: argparse.Namespace, part: Part) -> tuple[Path, str]:
    """Everything but films: a signal leaves no file."""
    from embodichain.recording.export.formats import export

    try:
        return export(log, options.format, options.output, part), ""
    except Interrupted as error:
        raise Interrupted(
            f"{error}; nothing was written, an export is whole or not there"
        ) from None


def _film(log: Log, options: argparse.Namespace, part: Part) -> tuple[Path, str]:
    """A film: a signal ends it. Returns what to say of that, too."""
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.recording.export.formats import export
    from embodichain.recording.film import Filmed

    filmed = Filmed(0, -1, whole=False)
    with StopFlag() as stop, ProgressDisplay("film", None, "pictures", quiet=options.json) as bar:
        show = shown(bar)

        def progress(now: Filmed) -> None:
            nonlocal filmed
            filmed = now
            show(now)

        def stopped() -> bool:
            return stop.stopped is not None

        path = export(log, options.format, options.output, part, progress=progress, stop=stopped)
        if not filmed.pictures:
            raise Interrupted(ended_early(stop, filmed, path))
        return path, ended_early(stop, filmed, path) if stop.stopped is not None else ""


def _size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    return sum(file.stat().st_size for file in files)
