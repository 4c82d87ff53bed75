"""`Dashboard`: how a training goes, live on a terminal; a line now and then elsewhere.

What is counted is `embodichain.learning.episodes`'s; how far anything else is, `progress.py` shows.
Written to stderr.
"""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import IO, TYPE_CHECKING

from embodichain.cli.output import console
from embodichain.cli.progress import ProgressDisplay

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live
    from rich.text import Text

    from embodichain.learning.episodes import TrainStatistics

__all__ = ["Dashboard"]

_PERIOD = 1.0
_CURVE = 30
_BLOCKS = "▁▂▃▄▅▆▇█"
_COLOURS = {"physics": "cyan", "environment": "blue", "policy": "green", "update": "magenta"}


class Dashboard:
    """Shows a training; a context manager.

    On a terminal: progress and time left, speed and where the time goes, return, success and length
    of the last episodes with their curves so far, and the best checkpoint; drawn every second
    from the training's own thread, in a few milliseconds. Elsewhere a line every ten seconds.

    Args:
        label: What is learned.
        algo: By which algorithm.
        total: Environment steps wanted.
        quiet: Show nothing.
        stream: Where to; None is stderr.
        live: Whether that is a terminal; None asks it.
    """

    def __init__(
        self,
        label: str,
        algo: str,
        total: int | None,
        *,
        quiet: bool = False,
        stream: IO[str] | None = None,
        live: bool | None = None,
    ) -> None:
        self._title, self._total = f"{label}, {algo}", total or 0
        is_live = (stream or sys.stderr).isatty() if live is None else live
        self._live: Live | None = None
        self._console = _console(stream) if is_live and not quiet else None
        self._lines = ProgressDisplay(label, total, "steps", quiet=quiet or is_live)
        self._due = time.perf_counter()
        self._curves: dict[str, dict[int, float]] = {}
        self._last: TrainStatistics | None = None

    def __enter__(self) -> Dashboard:
        if self._console is not None:
            from rich.live import Live

            # Drawn only when asked to: no thread competes with the simulation.
            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            if self._last is not None:
                self.show(self._last)
            self._live.stop()

    @property
    def due(self) -> bool:
        """Whether it is time to `show` again; cheap enough to ask in every step."""
        if self._live is None:
            return self._lines.due
        return time.perf_counter() >= self._due

    def show(self, statistics: TrainStatistics) -> None:
        """Show how it goes."""
        if self._live is None:
            self._lines.show(statistics.env_steps, _facts(statistics))
            return
        self._last = statistics
        self._live.update(self._drawn(statistics), refresh=True)
        self._due = time.perf_counter() + _PERIOD

    # -- drawing -------------------------------------------------------------------------------

    def _drawn(self, statistics: TrainStatistics) -> RenderableType:
        from rich.progress_bar import ProgressBar
        from rich.table import Table

        done, total = statistics.env_steps, max(self._total, 1)
        top = Table.grid(padding=(0, 2), expand=True)
        for ratio in (None, 1, None):
            top.add_column(no_wrap=True, ratio=ratio)
        count = f"{done:,}/{self._total:,} steps"
        top.add_row(self._title, ProgressBar(total, min(done, total)), count)
        rows = Table.grid(padding=(0, 2))
        for width in (8, 16, None):
            rows.add_column(no_wrap=True, min_width=width)
        speed, split = statistics.env_steps_per_second, statistics.fractions
        rows.add_row("speed", f"{speed:,.0f} steps/s", _bar(split))
        rows.add_row("time", _times(statistics, self._total), _shares(split))
        for name, value, text, bounds in _episode_facts(statistics):
            rows.add_row(name, text, self._curve(name, value, done / total, bounds))
        rows.add_row("best", *_best(statistics))
        rows.add_row("episodes", f"{statistics.episodes:,}", "")
        whole = Table.grid(expand=True)
        whole.add_row(top)
        whole.add_row(rows)
        return whole

    def _curve(
        self, name: str, value: float | None, where: float, bounds: tuple[float, float] | None
    ) -> str:
        """The values seen so far over the whole training, one character a column."""
        seen = self._curves.setdefault(name, {})
        if value is None:
            return ""
        seen[min(int(where * _CURVE), _CURVE - 1)] = value
        low, high = bounds or (min(seen.values()), max(seen.values()))
        scale = (len(_BLOCKS) - 1) / (high - low) if high > low else 0.0
        drawn, last = [], " "
        for column in range(max(seen) + 1):
            if column in seen:
                last = _BLOCKS[round((seen[column] - low) * scale)]
            drawn.append(last)
        return "".join(drawn)


def _console(stream: IO[str] | None) -> Console:
    if stream is None:
        return console(stderr=True)
    from rich.console import Console

    return Console(file=stream, force_terminal=True, width=100, highlight=False, markup=False)


def _facts(statistics: TrainStatistics) -> dict[str, str]:
    """What a line says besides the steps."""
    facts = {"steps/s": f"{statistics.env_steps_per_second:,.0f}"}
    facts["episodes"] = str(statistics.episodes)
    if statistics.mean_return is not None:
        facts["return"] = f"{statistics.mean_return:.3g}"
    if statistics.success_rate is not None:
        facts["success"] = f"{statistics.success_rate:.0%}"
    return facts


def _episode_facts(
    statistics: TrainStatistics,
) -> list[tuple[str, float | None, str, tuple[float, float] | None]]:
    """Name, value, text and fixed bounds of what has a curve."""
    mean, success = statistics.mean_return, statistics.success_rate
    length = statistics.mean_length
    return [
        ("return", mean, "-" if mean is None else f"{mean:.4g}", None),
        ("success", success, "-" if success is None else f"{success:.0%}", (0.0, 1.0)),
        ("length", length, "-" if length is None else f"{length:.4g}", None),
    ]


def _times(statistics: TrainStatistics, total: int) -> str:
    """Time taken, and time left if it goes on like that."""
    speed = statistics.env_steps_per_second
    left = _clock(max(total - statistics.env_steps, 0) / speed) if speed > 0 else "-"
    return f"{_clock(statistics.seconds)}, left {left}"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def _bar(fractions: dict[str, float]) -> Text:
    """The parts of the wall time, side by side."""
    from rich.text import Text

    text = Text()
    for name, share in fractions.items():
        text.append("█" * round(share * _CURVE), style=_COLOURS[name])
    return text


def _shares(fractions: dict[str, float]) -> Text:
    """Their names and percents."""
    from rich.text import Text

    text = Text()
    for name, share in fractions.items():
        text.append(f"{'  ' if text else ''}{name} {share:.0%}", style=_COLOURS[name])
    return text


def _best(statistics: TrainStatistics) -> tuple[str, str]:
    """Score of the best checkpoint, and when it was."""
    if statistics.best is None:
        return "-", ""
    steps, (success, mean) = statistics.best
    score = f"return {mean:.4g}" if statistics.success_rate is None else f"success {success:.0%}"
    return score, f"at {steps:,} steps"
