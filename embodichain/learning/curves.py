"""`curves.png`: how a training went, drawn from its `progress.csv`. Needs the extra `plot`."""

from __future__ import annotations

import csv
import importlib.util
import logging
from pathlib import Path

from embodichain.learning.train_logs import PROGRESS_FILE

__all__ = ["CURVES_FILE", "draw_curves"]

CURVES_FILE = "curves.png"
_STEPS = "time/total_timesteps"
_PANELS = {
    "rollout/ep_rew_mean": "mean return",
    "rollout/success_rate": "success rate",
    "rollout/ep_len_mean": "mean length (control steps)",
}
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
    from matplotlib.ticker import EngFormatter

    figure = Figure(figsize=(5 * len(columns), 3.5), layout="constrained")
    for axes, (name, points) in zip(
        figure.subplots(1, len(columns), squeeze=False)[0], columns.items(), strict=True
    ):
        axes.plot(*zip(*points, strict=True))
        axes.set_xlabel("environment steps")
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 200k, 1M: long numbers overlap
        axes.set_title(_PANELS[name])
        axes.grid(alpha=0.3)
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
