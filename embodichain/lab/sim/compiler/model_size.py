"""Large models: refused at once where MuJoCo would need hours, else reported while it works."""

from __future__ import annotations

import logging
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from embodichain.utils.errors import ConfigError

__all__ = ["check_copies", "check_depth", "reported"]

_log = logging.getLogger(__name__)

MAX_COPIES = 100_000
"""Copies that `<replicate>` may make: MuJoCo's time grows with their square, 3 s for 5,000."""
MAX_DEPTH = 1024
"""Links in a chain: MuJoCo's limit for a tree's depth, which it reports after minutes."""
_FIRST = 5.0  # seconds to the first report; each later one is after twice the time


@contextmanager
def reported(what: str) -> Iterator[None]:
    """Report, 5, 10, 20, ... seconds after its beginning, that a long work is not done yet.

    Args:
        what: What is being done, with its file.
    """
    done = threading.Event()
    start = time.monotonic()

    def report() -> None:
        wait = _FIRST
        while not done.wait(wait):
            passed = time.monotonic() - start
            _log.warning("%s: not done after %.0f s", what, passed)
            wait = passed

    thread = threading.Thread(target=report, name="report", daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def check_depth(path: Path, parents: dict[str, str]) -> None:
    """Refuse a URDF whose tree is deeper than MuJoCo allows.

    Args:
        path: The file.
        parents: Link -> the link that carries it.

    Raises:
        ConfigError: If it is; names the deepest link.
    """
    depths: dict[str, int] = {}
    for link in parents:
        chain: list[str] = []
        at = link
        while at in parents and at not in depths and len(chain) <= len(parents):
            chain.append(at)
            at = parents[at]
        depth = depths.get(at, 1)
        for name in reversed(chain):
            depth += 1
            depths[name] = depth
    deepest = max(depths, key=lambda name: depths[name], default="")
    if deepest and depths[deepest] > MAX_DEPTH:
        raise ConfigError(
            f"{path}: link {deepest!r} is at the end of a chain of {depths[deepest]:,} links; "
            f"MuJoCo allows {MAX_DEPTH:,}"
        )


def check_copies(path: Path, root: ET.Element, line_of: dict[ET.Element, int]) -> None:
    """Refuse an MJCF whose `<replicate>` elements make more copies than MuJoCo can.

    Args:
        path: The file.
        root: Its root.
        line_of: Lines of its elements.

    Raises:
        ConfigError: If they do, with the line of the outermost one.
    """
    for element in root.iter("replicate"):
        copies = _copies(element)
        if copies > MAX_COPIES:
            line = f":{line_of[element]}" if element in line_of else ""
            raise ConfigError(
                f"{path}{line}: <replicate> makes {copies:,} copies; at most "
                f"{MAX_COPIES:,} fit: MuJoCo's time grows with their square"
            )
    for include in root.iter("include"):
        file = path.parent / include.get("file", "")
        try:
            inner = ET.parse(file).getroot()
        except (OSError, ET.ParseError):
            continue  # MuJoCo reports it
        for child in inner.findall(".//include"):
            if (path.parent / child.get("file", "")) == file:
                return  # it includes itself: MuJoCo reports it
        check_copies(file, inner, {})


def _copies(element: ET.Element) -> int:
    """Copies that a `<replicate>` makes, with those in it."""
    try:
        count = max(1, int(float(element.get("count", "1"))))
    except (ValueError, OverflowError):
        return 1  # MuJoCo reports it
    inside = [child for child in element.iter("replicate") if child is not element]
    return count * max((_copies(child) for child in inside), default=1)
