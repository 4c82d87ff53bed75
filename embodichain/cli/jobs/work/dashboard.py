"""`Dashboard`: a training's progress, live on a terminal, else as a line every ten seconds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from embodichain.cli.terminal.output import result_number
from embodichain.cli.terminal.reporting import ProgressDisplay, progress_row

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

    from embodichain.learning.evaluation.episodes import TrainStatistics

__all__ = ["Dashboard"]

_PERIOD = 1.0
"""Seconds between two drawings."""
_CURVE = 30
"""Characters of a curve over the whole training, and of the bar of shares."""
_BLOCKS = "▁▂▃▄▅▆▇█"
_COLOURS = {"physics": "cyan", "environment": "blue", "policy": "green", "update": "magenta"}


class _Row(NamedTuple):
    """A result that has a curve: its value now, its text, and the ends of its scale."""

    name: str
    value: float | None
    text: Callable[[float], str]
    scale: tuple[float, float] | None = None


class Dashboard(ProgressDisplay):
    """Shows the progress of a training; a context manager.

    On a terminal: progress and time left, speed and shares of the time, return, success and length
    of the last episodes with their curves so far, and the best checkpoint; drawn every second
    in the training's thread, in a few milliseconds.

    Args:
        label: Name of the task.
        algo: Name of the algorithm.
        total: Length of the training in environment steps.
        quiet: Show nothing.
    """

    def __init__(self, label: str, algo: str, total: int, *, quiet: bool = False) -> None:
        super().__init__(label, total, "steps", quiet=quiet, period=_PERIOD)
        self._title = f"{label}, {algo}"
        self._steps = max(total, 1)
        self._curves: dict[str, dict[int, float]] = {}
        self._last: TrainStatistics | None = None

    def __exit__(self, *error: object) -> None:
        if self._last is not None and self.is_live:
            self.update(self._last)
        super().__exit__(*error)

    def update(self, statistics: TrainStatistics) -> None:
        """Show the state of the training."""
        self._last = statistics
        facts = {
            "steps/s": f"{statistics.env_steps_per_second:,.0f}",
            "episodes": str(statistics.episodes),
        }
        if statistics.mean_return is not None:
            facts["return"] = result_number(statistics.mean_return)
        if statistics.success_rate is not None:
            facts["success"] = f"{statistics.success_rate:.0%}"
        self.show(statistics.env_steps, facts, lambda: self._draw(statistics))

    def _draw(self, statistics: TrainStatistics) -> RenderableType:
        from rich.table import Table

        done = statistics.env_steps
        speed = statistics.env_steps_per_second
        time_left = "-"
        if speed > 0:
            time_left = _clock(max(self._steps - done, 0) / speed)
        bar, legend = _shares(statistics)
        rows = Table.grid(padding=(0, 2))
        for width in (8, 16, None):
            rows.add_column(no_wrap=True, min_width=width)
        rows.add_row("speed", f"{speed:,.0f} steps/s", bar)
        rows.add_row("time", f"{_clock(statistics.seconds)}, left {time_left}", legend)
        for row in (
            _Row("return", statistics.mean_return, result_number),
            _Row("success", statistics.success_rate, "{:.0%}".format, scale=(0.0, 1.0)),
            _Row("length", statistics.mean_length, result_number),
        ):
            if row.value is None:
                rows.add_row(row.name, "-", "")
            else:
                curve = self._curve(row.name, row.value, done / self._steps, row.scale)
                rows.add_row(row.name, row.text(row.value), curve)
        rows.add_row("best", *_best(statistics))
        rows.add_row("episodes", f"{statistics.episodes:,}", "")
        dashboard = Table.grid(expand=True)
        count = f" {done:,}/{self.total:,} steps"
        dashboard.add_row(progress_row(f"{self._title} ", done, self._steps, count))
        dashboard.add_row(rows)
        return dashboard

    def _curve(
        self, name: str, value: float, where: float, scale: tuple[float, float] | None
    ) -> str:
        """Add a value to its curve, and draw that: one character for each part of the training.

        Args:
            name: The curve.
            value: The newest value; it replaces an earlier one of the same part.
            where: The share of the training that is done.
            scale: Values at the bottom and the top; None is the least and the largest so far.
        """
        values = self._curves.setdefault(name, {})
        values[min(int(where * _CURVE), _CURVE - 1)] = value
        low, high = scale or (min(values.values()), max(values.values()))
        blocks = 0.0
        if high > low:
            blocks = (len(_BLOCKS) - 1) / (high - low)
        characters = []
        character = " "
        for column in range(max(values) + 1):
            if column in values:
                character = _BLOCKS[round((values[column] - low) * blocks)]
            characters.append(character)  # a part without a value repeats the one before
        return "".join(characters)


def _shares(statistics: TrainStatistics) -> tuple[Text, Text]:
    """The shares of the time: a coloured bar, and its legend."""
    from rich.text import Text

    bar = Text()
    legend = Text()
    for name, share in statistics.fractions.items():
        bar.append("█" * round(share * _CURVE), style=_COLOURS[name])
        if legend:
            legend.append("  ")
        legend.append(f"{name} {share:.0%}", style=_COLOURS[name])
    return bar, legend


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours}:{minutes:02}:{seconds:02}"
    return f"{minutes}:{seconds:02}"


def _best(statistics: TrainStatistics) -> tuple[str, str]:
    """Score of the best checkpoint, and its environment step."""
    if statistics.best is None:
        return "-", ""
    steps, (success, mean_return) = statistics.best
    if statistics.success_rate is None:
        score = f"return {result_number(mean_return)}"
    else:
        score = f"success {success:.0%}"
    return score, f"at {steps:,} steps"
