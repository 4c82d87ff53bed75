"""`Dashboard`: a training's progress, live on a terminal, else as a line every ten seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.cli.terminal.reporting import ProgressDisplay, progress_row

if TYPE_CHECKING:
    from rich.console import RenderableType

    from embodichain.learning.evaluation.episodes import TrainStatistics

__all__ = ["Dashboard"]

_PERIOD = 1.0
_CURVE = 30
_BLOCKS = "▁▂▃▄▅▆▇█"
_COLOURS = {"physics": "cyan", "environment": "blue", "policy": "green", "update": "magenta"}


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
        self._title, self._steps = f"{label}, {algo}", max(total, 1)
        self._curves: dict[str, dict[int, float]] = {}
        self._last: TrainStatistics | None = None

    def __exit__(self, *error: object) -> None:
        if self._last is not None and self.is_live:
            self.update(self._last)
        super().__exit__(*error)

    def update(self, statistics: TrainStatistics) -> None:
        """Show the state of the training."""
        self._last = statistics
        mean, success = statistics.mean_return, statistics.success_rate
        facts = {
            "steps/s": f"{statistics.env_steps_per_second:,.0f}",
            "episodes": str(statistics.episodes),
            **({} if mean is None else {"return": f"{mean:.3g}"}),
            **({} if success is None else {"success": f"{success:.0%}"}),
        }
        self.show(statistics.env_steps, facts, lambda: self._drawn(statistics))

    def _drawn(self, statistics: TrainStatistics) -> RenderableType:
        from rich.table import Table
        from rich.text import Text

        done, speed = statistics.env_steps, statistics.env_steps_per_second
        left = _clock(max(self._steps - done, 0) / speed) if speed > 0 else "-"
        bar, shares = Text(), Text()
        for name, share in statistics.fractions.items():
            bar.append("█" * round(share * _CURVE), style=_COLOURS[name])
            shares.append(f"{'  ' if shares else ''}{name} {share:.0%}", style=_COLOURS[name])
        rows = Table.grid(padding=(0, 2))
        for width in (8, 16, None):
            rows.add_column(no_wrap=True, min_width=width)
        rows.add_row("speed", f"{speed:,.0f} steps/s", bar)
        rows.add_row("time", f"{_clock(statistics.seconds)}, left {left}", shares)
        for name, value, form, bounds in (
            ("return", statistics.mean_return, ".4g", None),
            ("success", statistics.success_rate, ".0%", (0.0, 1.0)),
            ("length", statistics.mean_length, ".4g", None),
        ):
            curve = "" if value is None else self._curve(name, value, done / self._steps, bounds)
            rows.add_row(name, "-" if value is None else format(value, form), curve)
        rows.add_row("best", *_best(statistics))
        rows.add_row("episodes", f"{statistics.episodes:,}", "")
        whole = Table.grid(expand=True)
        count = f" {done:,}/{self.total:,} steps"
        whole.add_row(progress_row(f"{self._title} ", done, self._steps, count))
        whole.add_row(rows)
        return whole

    def _curve(
        self, name: str, value: float, where: float, bounds: tuple[float, float] | None
    ) -> str:
        """A curve of the values so far over the length of the training, one character a column."""
        seen = self._curves.setdefault(name, {})
        seen[min(int(where * _CURVE), _CURVE - 1)] = value
        low, high = bounds or (min(seen.values()), max(seen.values()))
        scale = (len(_BLOCKS) - 1) / (high - low) if high > low else 0.0
        drawn, last = [], " "
        for column in range(max(seen) + 1):
            if column in seen:
                last = _BLOCKS[round((seen[column] - low) * scale)]
            drawn.append(last)
        return "".join(drawn)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def _best(statistics: TrainStatistics) -> tuple[str, str]:
    """Score of the best checkpoint, and its environment step."""
    if statistics.best is None:
        return "-", ""
    steps, (success, mean) = statistics.best
    score = f"return {mean:.4g}" if statistics.success_rate is None else f"success {success:.0%}"
    return score, f"at {steps:,} steps"
