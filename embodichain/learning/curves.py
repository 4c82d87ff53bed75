"""`curves.png`: how a training went, drawn from its `progress.csv`. Needs the extra `plot`."""

from __future__ import annotations

import csv
import importlib.util
import logging
from pathlib import Path

from embodichain.learning.axes import set_axes
from embodichain.learning.train_logs import PROGRESS_FILE

__all__ = ["CURVES_FILE", "draw_curves"]

CURVES_FILE = "curves.png"
_STEPS = "time/total_timesteps"
_PANELS = {
    "rollout/ep_rew_mean": "mean return",
    "rollout/success_rate": "success rate",
    "rollout/ep_len_mean": "mean length (control steps)",
}
_SHARE = "rollout/success_rate"
_log = logging.getLogger(__name__)


def draw_curves(run_dir: Path) -> Path | None:
    """Draw return, success and length of episodes over environment steps.

    Args:
        run_dir: A run's folder with `progress.csv`.

    Returns:
        The picture; None where matplotlib is not installed or no episode ended.
    """
    columns = _columns(run_dir / PROGRESS_FILE)
    if not columns:
        return None
    if importlib.util.find_spec("matplotlib") is None:
        _log.info("no %s: pip install 'embodichain[plot]'", CURVES_FILE)
        return None
    from matplotlib.figure import Figure  # without pyplot: no display, no global state

    figure = Figure(figsize=(5 * len(columns), 3.5), layout="constrained")
    for axes, (name, points) in zip(
        figure.subplots(1, len(columns), squeeze=False)[0], columns.items(), strict=True
    ):
        steps, values = zip(*points, strict=True)
        axes.plot(steps, values, marker="o" if len(points) == 1 else "")
        set_axes(axes, steps[-1], values, share=name == _SHARE)
        axes.set_title(_PANELS[name])
    path = run_dir / CURVES_FILE
    figure.savefig(path, dpi=100)
    return path


def _columns(path: Path) -> dict[str, list[tuple[float, float]]]:
    """Steps and value of the rows of each panel that has some."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    found = {
        name: [(float(row[_STEPS]), float(row[name])) for row in rows if row.get(name)]
        for name in _PANELS
    }
    return {name: points for name, points in found.items() if points}
