"""Flip one bit in every byte of a log, and verify each: `python scripts/flip_bits.py [LOG]`.

Without a log a small one is recorded. Prints how many changes went unnoticed, and where; the exit
code is 1 if any did. The offset of a byte decides which of its bits is flipped, so that all eight
occur; `--bits all` flips each of them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
UNCOVERED: dict[str, str] = {}
"""Kind of a record to the reason why a change in it goes unnoticed. There is none: everything up
to DATA_END is in the checksum there, everything after it in the footer's, and the magic at both
ends is compared."""


class Flip(NamedTuple):
    """Result of one flipped bit.

    Attributes:
        offset: The byte.
        bit: The bit, 0 is the lowest.
        found: Whether the log was not verified any more.
        first: The kind of the record that was named first; ``simulated`` if none was.
    """

    offset: int
    bit: int
    found: bool
    first: str


def main() -> int:
    """Flip, verify, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path, nargs="?", help="the log; it is copied")
    parser.add_argument("--bits", choices=("one", "all"), default="one", help="of each byte")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=_memory()) as folder:
        path = Path(folder) / "log.mcap"
        if options.log is None:
            record(path)
        else:
            path.write_bytes(options.log.read_bytes())
        size = path.stat().st_size
        started = time.perf_counter()
        results = list(flips(path, range(size), all_bits=options.bits == "all"))
        seconds = time.perf_counter() - started
    unnoticed = [flip for flip in results if not flip.found]
    sys.stdout.write(f"{len(results)} flips in {size} bytes, {seconds:.0f} s\n")
    for kind, count in Counter(flip.first for flip in results).most_common():
        sys.stdout.write(f"{count:8} {kind}\n")
    for flip in unnoticed:
        sys.stdout.write(f"unnoticed: bit {flip.bit} of byte {flip.offset}\n")
    return 1 if unnoticed else 0


def _memory() -> str | None:
    """A folder in memory, if there is one: a file is written for each flip."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def record(path: Path) -> Path:
    """A small log with everything that logs have."""
    sys.path.insert(0, str(ROOT))
    from embodichain.recording import McapRecorder
    from tests.recording.scene import SmallEnv

    small: Any = SmallEnv
    env = small(num_envs=2, settle=2, push=True)
    recorder = McapRecorder(path, env, "seed: 0\n", ["seed=0"], None, "small")
    env.add_observer(recorder)
    env.reset()
    for step in range(12):
        env.step()
        if step == 6:
            recorder.flush()  # the end of a chunk
    env.close()
    return path


def flips(path: Path, offsets: Iterable[int], all_bits: bool = False) -> Iterator[Flip]:
    """Flip a bit of each of these bytes in the file itself, verify it, and flip it back."""
    from embodichain.recording import verify
    from embodichain.utils.errors import ConfigError

    with path.open("r+b", buffering=0) as stream:
        for offset in offsets:
            stream.seek(offset)
            (byte,) = stream.read(1)
            bits = range(8) if all_bits else [offset % 8]
            for bit in bits:
                stream.seek(offset)
                stream.write(bytes([byte ^ 1 << bit]))
                try:
                    report = verify(path, num_threads=1)
                except ConfigError as error:
                    yield Flip(offset, bit, True, f"refused: {type(error).__name__}")
                else:
                    first = report.damage[0].kind if report.damage else "simulated"
                    yield Flip(offset, bit, not report.ok, first)
            stream.seek(offset)
            stream.write(bytes([byte]))


if __name__ == "__main__":
    raise SystemExit(main())
