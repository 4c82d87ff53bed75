"""Plots of learning curves, of one training or of several. Needs the extra `plot`."""

from __future__ import annotations

import importlib.util
import logging
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
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

__all__ = ["CURVES_FILE", "curves_svg", "draw_curves", "plot_curves", "set_axes"]

CURVES_FILE = "curves.png"
_TITLES = {
    RETURN: "mean return",
    SUCCESS: "success rate",
    LENGTH: "mean length (control steps)",
}
_CURRICULUM = "Curriculum/"
_LINE = 90  # characters that fit the picture's width
_MARGIN = 0.05
_LEAST = 0.05
"""Smallest range of an axis, as a share of its largest value, so that small changes look flat."""
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

    stages = read_curves(run_dir / PROGRESS, lambda name: name.startswith(_CURRICULUM))
    count = len(curves) + bool(stages)
    figure = Figure(figsize=(5.0 * count, 3.5), layout="constrained")
    panels = figure.subplots(1, count, squeeze=False)[0]
    for axes, name in zip(panels, [n for n in _TITLES if n in curves], strict=False):
        steps, values = curves[name].steps, curves[name].values
        axes.plot(steps, values, marker="o" if len(steps) == 1 else "")
        set_axes(axes, float(steps[-1]), values.tolist(), share=name == SUCCESS)
        axes.set_title(_TITLES[name])
    if stages:
        _draw_curriculum(panels[-1], stages)
    path = run_dir / CURVES_FILE
    figure.savefig(path, dpi=100)
    return path


def _draw_curriculum(axes: Any, stages: Mapping[str, Curve]) -> None:
    for name, curve in sorted(stages.items()):
        label = name.removeprefix(_CURRICULUM)
        marker = "o" if len(curve.steps) == 1 else ""
        axes.plot(curve.steps, curve.values, label=label, marker=marker)
    last_step = max(float(curve.steps[-1]) for curve in stages.values())
    values = [value for curve in stages.values() for value in curve.values.tolist()]
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


def curves_svg(groups: Sequence[Group], labels: Sequence[str]) -> str:
    """Return the same curves as text of an SVG picture, for a page; empty without any.

    Args:
        groups: The groups to compare.
        labels: A label for each.

    Raises:
        ConfigError: If matplotlib is missing.
    """
    if not any(run.curves for group in groups for run in group.runs):
        return ""
    figure = _figure(groups, labels)
    import matplotlib as mpl

    stream = StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "sweep"}):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def _figure(groups: Sequence[Group], labels: Sequence[str]) -> Any:
    """Draw the curves of groups that have any; the groups' colours are in a legend below."""
    try:
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D
    except ImportError as error:
        message = "curves need the package matplotlib: pip install 'embodichain[plot]'"
        raise ConfigError(message) from error
    names = [
        n
        for n in (SUCCESS, RETURN)
        if any(n in run.curves for group in groups for run in group.runs)
    ]
    texts = [
        _wrapped(f"{label}  (seeds: {len(group.runs)})")
        for group, label in zip(groups, labels, strict=True)
    ]
    lines = sum(text.count("\n") + 1 for text in texts)
    figure = Figure(figsize=(7.0, 3.0 * len(names) + 0.2 * lines), layout="constrained")
    for axes, name in zip(figure.subplots(len(names), squeeze=False)[:, 0], names, strict=True):
        _draw(axes, groups, name)
    # One legend, below the axes: labels of groups are as long as their overrides.
    colours = [Line2D([], [], color=f"C{i}") for i in range(len(groups))]
    figure.legend(colours, texts, loc="outside lower left", fontsize="small", frameon=False)
    return figure


def _draw(axes: Any, groups: Sequence[Group], name: str) -> None:
    last_step, drawn = 0.0, list[float]()
    for number, group in enumerate(groups):
        curves = [run.curves[name] for run in group.runs if name in run.curves]
        if not curves:
            continue
        try:
            steps, mean, low, high = band(curves, share=name == SUCCESS)
        except ValueError as error:
            raise ConfigError(f"{group.label}: {error}") from error
        single = all(len(curve.steps) == 1 for curve in curves)
        axes.plot(steps, mean, color=f"C{number}", marker="o" if single else "")
        last_step = max(last_step, float(steps[-1]))
        if low is not None and high is not None:
            drawn += [*low.tolist(), *high.tolist()]
            axes.fill_between(steps, low, high, alpha=0.2, color=f"C{number}", linewidth=0)
            continue
        for curve in curves:  # too few for an interval
            drawn += curve.values.tolist()
            axes.plot(curve.steps, curve.values, alpha=0.4, color=f"C{number}", linewidth=0.7)
    axes.set_ylabel(_TITLES[name])
    set_axes(axes, last_step, drawn, share=name == SUCCESS)


def _wrapped(label: str) -> str:
    return textwrap.fill(label, _LINE, break_on_hyphens=False, break_long_words=False)


def set_axes(axes: Any, last_step: float, values: Iterable[float], *, share: bool) -> None:
    """Set the limits and tick labels of axes with curves.

    Args:
        axes: Axes of matplotlib.
        last_step: The last environment step of any curve.
        values: All values drawn.
        share: Whether the values are shares, such as success rates.
    """
    from matplotlib.ticker import EngFormatter

    drawn = list(values)
    low, high = (0.0, 1.0) if share else (min(drawn), max(drawn))
    least = _LEAST * max(abs(low), abs(high)) or 1.0
    middle, half = (low + high) / 2, max(high - low, least) / 2
    axes.set_ylim(middle - half * (1 + 2 * _MARGIN), middle + half * (1 + 2 * _MARGIN))
    axes.set_xlim(0.0, max(last_step, 1.0) * (1 + _MARGIN))
    axes.set_xlabel("environment steps")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 200k, 1M: long numbers overlap
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(alpha=0.3)
