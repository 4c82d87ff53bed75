"""Charts of runs: learning curves of a training, or of groups of them, rewards of a log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from embodichain.cli.pages.figures import Line, line_chart

if TYPE_CHECKING:
    from embodichain.learning.evaluation.comparison import Group
    from embodichain.recording.read.summary import LogSummary

__all__ = ["group_charts", "log_charts", "training_charts"]

_REWARD = "Episode_Reward/"
_CURRICULUM = "Curriculum/"
"""Before the names of terms in `progress.csv`."""
_MOST_POINTS = 300
"""Points of a curve over the control steps of a log."""
_LENGTH = "mean length (control steps)"


def training_charts(folder: Path) -> list[Markup]:
    """Draw the curves of a training: return, success, length, rewards by term, the curriculum.

    A length that is always the same, and the rewards of a single term, have no chart.

    Args:
        folder: The training's folder; without `progress.csv` there are none.

    Raises:
        ConfigError: The file is damaged.
    """
    from embodichain.learning.evaluation.comparison import (
        LENGTH,
        PROGRESS,
        RETURN,
        SUCCESS,
        read_curves,
    )

    titles = {SUCCESS: "success rate", RETURN: "mean return", LENGTH: _LENGTH}
    prefixes = {_REWARD: "rewards by term", _CURRICULUM: "curriculum"}
    curves = read_curves(folder / PROGRESS, lambda name: name.startswith((*titles, *prefixes)))
    charts = []
    for name, title in titles.items():
        is_constant_length = name == LENGTH and name in curves and np.ptp(curves[name].values) == 0
        if name in curves and not is_constant_length:
            line = Line(title, curves[name].steps, curves[name].values)
            charts.append(line_chart(title, [line], is_share=name == SUCCESS))
    for prefix, title in prefixes.items():
        names = [name for name in curves if name.startswith(prefix)]
        lines = [
            Line(name.removeprefix(prefix), curves[name].steps, curves[name].values, color=index)
            for index, name in enumerate(names)
        ]
        # The reward of a single term is the return.
        if lines and not (prefix == _REWARD and len(lines) == 1):
            charts.append(line_chart(title, lines))
    return charts


def log_charts(log: LogSummary) -> list[Markup]:
    """Draw the mean reward of all environments over the control steps of a log.

    Args:
        log: Its summary. A log of a task without rewards has no chart.

    Raises:
        LogError: No rewards are in the log, or it is damaged.
    """
    from embodichain.recording import open as open_log

    with open_log(log.path) as reader:
        rewards = reader.read("rewards")["rewards"].mean(axis=1, dtype=np.float64)
    if not rewards.any():
        return []
    # Means of equal parts, so that a long run has as many points as the picture has pixels.
    size = math.ceil(len(rewards) / _MOST_POINTS)
    starts = np.arange(0, len(rewards), size)
    means = np.add.reduceat(rewards, starts) / np.diff(starts, append=len(rewards))
    steps = log.header.first_step + starts.astype(np.float64)
    title = "mean reward of a control step"
    return [line_chart(title, [Line(title, steps, means)], x_label="control steps")]


def group_charts(groups: Sequence[Group], labels: Sequence[str]) -> list[Markup]:
    """Draw the mean curve of groups of trainings, with an interval over their seeds.

    A group with too few seeds for an interval has a thin line for each.

    Args:
        groups: The groups, those without curves too.
        labels: A label for each.

    Raises:
        ValueError: The curves of a group have no steps in common.
    """
    from embodichain.learning.evaluation.comparison import RETURN, SUCCESS

    charts = []
    for name, title in {SUCCESS: "success rate", RETURN: "mean return"}.items():
        lines: list[Line] = []
        for index, (group, label) in enumerate(zip(groups, labels, strict=True)):
            seeds = "1 seed" if len(group.runs) == 1 else f"{len(group.runs)} seeds"
            lines += _group_lines(group, name, f"{label} ({seeds})", index)
        if lines:
            charts.append(line_chart(title, lines, is_share=name == SUCCESS))
    return charts


def _group_lines(group: Group, name: str, label: str, color: int) -> list[Line]:
    """The mean of a group's curves with its band, or without one the curve of each seed."""
    from embodichain.learning.evaluation.comparison import SUCCESS, band

    curves = [run.curves[name] for run in group.runs if name in run.curves]
    if not curves:
        return []
    points = max(len(curve.steps) for curve in curves)
    steps, mean, low, high = band(curves, min(points, _MOST_POINTS), share=name == SUCCESS)
    lines = []
    if low is None and len(curves) > 1:
        lines = [
            Line(label, curve.steps, curve.values, color=color, is_faint=True) for curve in curves
        ]
    lines.append(Line(label, steps, mean, low=low, high=high, color=color))
    return lines
