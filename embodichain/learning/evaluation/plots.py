"""Plots of learning curves, of one training or of several. Needs the extra `plot`."""

from __future__ import annotations

import importlib.util
import logging
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from embodichain.learning.evaluation.comparison import (
    LENGTH,
    PROGRESS,
    RETURN,
    SUCCESS,
    Curve,
    Group,
    band,
    read_curves,
)
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import atomic_file

__all__ = ["CURVES_FILE", "draw_curves", "plot_curves", "set_axes"]

CURVES_FILE = "curves.png"
_TITLES = {
    RETURN: "mean return",
    SUCCESS: "success rate",
    LENGTH: "mean length (control steps)",
}
_CURRICULUM = "Curriculum/"
_LINE_WIDTH = 90
"""Characters that fit the picture's width."""
_MARGIN = 0.05
"""Empty space beside the curves, as a share of an axis."""
_CONSTANT = 0.01
"""Range below which values are a constant, as a share of the largest: the axis begins at 0."""
_SMALLEST_RANGE = 0.05
"""Smallest range of an axis, as a share of its largest value, so that small changes look flat."""
_FEWEST_IN_LINE = 3
"""Points below which there are dots instead of a line."""
_log = logging.getLogger(__name__)


def draw_curves(run_dir: Path) -> Path | None:
    """Draw return, success and length of episodes over environment steps as `curves.png`.

    A task with a curriculum has one more plot, with a line for each value of its terms.

    Args:
        run_dir: A training's folder with `progress.csv`.

    Returns:
        The picture's path; None if matplotlib is not installed or no episode ended.
    """
    curves = read_curves(run_dir / PROGRESS)
    if not curves:
        return None
    if importlib.util.find_spec("matplotlib") is None:
        _log.info("no %s: pip install 'embodichain[plot]'", CURVES_FILE)
        return None
    from matplotlib.figure import Figure  # without pyplot: no display, no global state

    curriculum = read_curves(run_dir / PROGRESS, lambda name: name.startswith(_CURRICULUM))
    count = len(curves)
    if curriculum:
        count += 1
    figure = Figure(figsize=(5.0 * count, 3.5), layout="constrained")
    panels = figure.subplots(1, count, squeeze=False)[0]
    names = [name for name in _TITLES if name in curves]
    for axes, name in zip(panels, names, strict=False):
        curve = curves[name]
        axes.plot(curve.steps, curve.values, _style(curve))
        set_axes(axes, float(curve.steps[-1]), curve.values.tolist(), share=name == SUCCESS)
        axes.set_title(_TITLES[name])
    if curriculum:
        _draw_curriculum(panels[-1], curriculum)
    path = run_dir / CURVES_FILE
    figure.savefig(path, dpi=100)
    return path


def _style(curve: Curve) -> str:
    """Return the line of a curve, or dots: two points are not a trend."""
    return "-" if len(curve.steps) >= _FEWEST_IN_LINE else "o"


def _draw_curriculum(axes: Any, curves: Mapping[str, Curve]) -> None:
    last_step = 0.0
    values: list[float] = []
    for name, curve in sorted(curves.items()):
        label = name.removeprefix(_CURRICULUM)
        axes.plot(curve.steps, curve.values, _style(curve), label=label)
        last_step = max(last_step, float(curve.steps[-1]))
        values += curve.values.tolist()
    set_axes(axes, last_step, values, share=False)
    axes.set_title("curriculum")
    axes.legend(fontsize="small")


def plot_curves(groups: Sequence[Group], path: Path) -> None:
    """Draw the mean curve of every group with a 95 % interval over its seeds, into a new file.

    A group with too few seeds for an interval has a thin line for each.

    Args:
        groups: The groups to compare.
        path: A new file; the suffix is the format (``.png``, ``.svg``, ``.pdf``).

    Raises:
        ConfigError: If the file exists or cannot be written, a run has no curves, or matplotlib is
            missing.
    """
    if os.path.lexists(path):
        raise ConfigError(f"{path} exists; it is never replaced")
    empty = [str(run.folder) for group in groups for run in group.runs if not run.curves]
    if empty:
        raise ConfigError(f"no curves in progress.csv of: {', '.join(empty)}")
    figure = _figure(groups, [group.label for group in groups])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path, new=True) as temporary:
            figure.savefig(temporary, dpi=150)
    except FileExistsError as error:
        raise ConfigError(f"{path} exists; it is never replaced") from error
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot write {path}: {error}") from error


def _figure(groups: Sequence[Group], labels: Sequence[str]) -> Any:
    """Draw the curves of groups that have any; the groups' colours are in a legend below."""
    try:
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D
    except ImportError as error:
        message = "curves need the package matplotlib: pip install 'embodichain[plot]'"
        raise ConfigError(message) from error
    runs = [run for group in groups for run in group.runs]
    names = [name for name in (SUCCESS, RETURN) if any(name in run.curves for run in runs)]
    texts = [
        _wrap(f"{label}  (seeds: {len(group.runs)})")
        for group, label in zip(groups, labels, strict=True)
    ]
    lines = sum(text.count("\n") + 1 for text in texts)
    figure = Figure(figsize=(7.0, 3.0 * len(names) + 0.2 * lines), layout="constrained")
    for axes, name in zip(figure.subplots(len(names), squeeze=False)[:, 0], names, strict=True):
        _draw_groups(axes, groups, name)
    # One legend, below the axes: labels of groups are as long as their overrides.
    colours = [Line2D([], [], color=f"C{i}") for i in range(len(groups))]
    figure.legend(colours, texts, loc="outside lower left", fontsize="small", frameon=False)
    return figure


def _draw_groups(axes: Any, groups: Sequence[Group], name: str) -> None:
    """Draw one quantity of all groups, each with its colour."""
    is_share = name == SUCCESS
    last_step = 0.0
    values: list[float] = []
    for number, group in enumerate(groups):
        curves = [run.curves[name] for run in group.runs if name in run.curves]
        if not curves:
            continue
        try:
            steps, mean, low, high = band(curves, share=is_share)
        except ValueError as error:
            raise ConfigError(f"{group.label}: {error}") from error
        color = f"C{number}"
        if all(len(curve.steps) < _FEWEST_IN_LINE for curve in curves):
            steps, mean, low, high = band(curves, _FEWEST_IN_LINE - 1, share=is_share)
            axes.plot(steps, mean, "o", color=color)
        else:
            axes.plot(steps, mean, color=color)
        last_step = max(last_step, float(steps[-1]))
        if low is not None and high is not None:
            axes.fill_between(steps, low, high, alpha=0.2, color=color, linewidth=0)
            values += low.tolist()
            values += high.tolist()
        else:  # too few seeds for an interval
            for curve in curves:
                axes.plot(curve.steps, curve.values, alpha=0.4, color=color, linewidth=0.7)
                values += curve.values.tolist()
    axes.set_ylabel(_TITLES[name])
    set_axes(axes, last_step, values, share=is_share)


def _wrap(label: str) -> str:
    return textwrap.fill(label, _LINE_WIDTH, break_on_hyphens=False, break_long_words=False)


def set_axes(axes: Any, last_step: float, values: Iterable[float], *, share: bool) -> None:
    """Set the limits and tick labels of axes with curves.

    Args:
        axes: Axes of matplotlib.
        last_step: The last environment step of any curve.
        values: All values drawn.
        share: Whether the values are shares, such as success rates.
    """
    from matplotlib.ticker import EngFormatter

    low = 0.0
    high = 1.0
    if not share:
        values = list(values)
        low = min(values)
        high = max(values)
        if high - low < _CONSTANT * max(abs(low), abs(high)):
            low = min(low, 0.0)
            high = max(high, 0.0)
    smallest_range = _SMALLEST_RANGE * max(abs(low), abs(high)) or 1.0
    middle = (low + high) / 2
    half = max(high - low, smallest_range) / 2 * (1 + 2 * _MARGIN)
    axes.set_ylim(middle - half, middle + half)
    axes.set_xlim(0.0, max(last_step, 1.0) * (1 + _MARGIN))
    axes.set_xlabel("environment steps")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 200k, 1M: long numbers overlap
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(alpha=0.3)
