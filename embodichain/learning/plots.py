"""Learning curves as a picture. What is drawn comes from `comparison.py`."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from embodichain.learning.axes import set_axes
from embodichain.learning.comparison import RETURN, SUCCESS, Group, band
from embodichain.utils.atomic import atomic_file
from embodichain.utils.errors import ConfigError

__all__ = ["plot_curves"]

_LINE = 90  # characters that fit the picture's width
_AXES = {SUCCESS: "success rate", RETURN: "mean return"}


def plot_curves(groups: Sequence[Group], path: Path) -> None:
    """Draw the curves of every group with 95 % intervals over its seeds, into a new file.

    Args:
        groups: What is compared.
        path: A new file; its suffix says the format (``.png``, ``.svg``, ``.pdf``).

    Raises:
        ConfigError: If the file exists or cannot be written, a run has no curves, or matplotlib is
            missing.
    """
    if os.path.lexists(path):
        raise ConfigError(f"{path} exists; it is never replaced")
    empty = [str(run.folder) for group in groups for run in group.runs if not run.curves]
    if empty:
        raise ConfigError(f"no curves in progress.csv of: {', '.join(empty)}")
    try:
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D
    except ImportError as error:
        message = "curves need the package matplotlib: pip install 'embodichain[plot]'"
        raise ConfigError(message) from error
    names = [n for n in _AXES if any(n in run.curves for group in groups for run in group.runs)]
    labels = [_wrapped(f"{group.label}  (seeds: {len(group.runs)})") for group in groups]
    lines = sum(label.count("\n") + 1 for label in labels)
    figure = Figure(figsize=(7.0, 3.0 * len(names) + 0.2 * lines), layout="constrained")
    for axes, name in zip(figure.subplots(len(names), squeeze=False)[:, 0], names, strict=True):
        _draw(axes, groups, name)
    # Once, below: what groups are called is as long as their overrides.
    colours = [Line2D([], [], color=f"C{i}") for i in range(len(groups))]
    figure.legend(colours, labels, loc="outside lower left", fontsize="small", frameon=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path, new=True) as temporary:
            figure.savefig(temporary, dpi=150)
    except FileExistsError as error:
        raise ConfigError(f"{path} exists; it is never replaced") from error
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot write {path}: {error}") from error


def _draw(axes: Any, groups: Sequence[Group], name: str) -> None:
    last_step, drawn = 0.0, list[float]()
    for number, group in enumerate(groups):
        curves = [run.curves[name] for run in group.runs if name in run.curves]
        if not curves:
            continue
        try:
            steps, mean, low, high = band(curves)
        except ValueError as error:
            raise ConfigError(f"{group.label}: {error}") from error
        single = all(len(curve.steps) == 1 for curve in curves)
        axes.plot(steps, mean, color=f"C{number}", marker="o" if single else "")
        last_step = max(last_step, float(steps[-1]))
        drawn += [*low.tolist(), *high.tolist()]
        if len(curves) > 1:
            axes.fill_between(steps, low, high, alpha=0.2, color=f"C{number}", linewidth=0)
    axes.set_ylabel(_AXES[name])
    set_axes(axes, last_step, drawn, share=name == SUCCESS)


def _wrapped(label: str) -> str:
    return textwrap.fill(label, _LINE, break_on_hyphens=False, break_long_words=False)
