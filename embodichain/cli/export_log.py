"""`embodichain export FILE --format ...`: a log in the format that another program reads."""

from __future__ import annotations

import sys
from pathlib import Path

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.log_files import log_of
from embodichain.cli.logs import warnings_on_stderr
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

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
    from embodichain.recording.export.formats import Part, export

    if options.episode is not None and options.env is None:
        raise ConfigError("--episode needs --env: episodes are counted in each environment")
    part = Part(options.env, options.episode, options.start, options.stop)
    with warnings_on_stderr(), Log(log_of(options.file), simulate=True) as log:
        path = export(log, options.format, options.output, part)
        for warning in log.warnings:
            sys.stderr.write(f"warning: {log.path}: {warning}\n")
        if options.json:
            print_json({"file": str(path), "bytes": _size(path), "complete": log.complete})
        else:
            sys.stdout.write(f"{path}: {_size(path) / 1e6:.2f} MB\n")
    return exits.OK


def _size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    return sum(file.stat().st_size for file in files)
