"""The blueprint of a recording for Rerun: the scene, beside it joints, reward and what happened."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.recording.export.formats import required

__all__ = ["layout"]

_FROM = np.array([1.0, -1.2, 0.8])
"""Where the eye is, seen from the middle of the scene."""


def layout(model: mujoco.MjModel, envs: Sequence[int], places: NDArray[np.float64]) -> Any:
    """A `rerun.blueprint.Blueprint`.

    Args:
        model: The scene's model.
        envs: The environments that are shown; curves are those of the first.
        places: (n, 3) where each stands, metres.

    Raises:
        ConfigError: If rerun is not installed.
    """
    rrb: Any = required("rerun.blueprint", "rrd")
    center = np.array(model.stat.center, np.float64) + places.mean(axis=0)
    size = float(model.stat.extent) + float(np.linalg.norm(np.ptp(places, axis=0)))
    eye = center + size * _FROM / np.linalg.norm(_FROM)
    first = f"/env_{envs[0]}"
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(
                origin="/world",
                name="scene",
                eye_controls=rrb.EyeControls3D(position=eye, look_target=center, eye_up=(0, 0, 1)),
            ),
            rrb.Vertical(
                rrb.TimeSeriesView(
                    origin=f"{first}/joint_positions", name="joint positions (rad, m)"
                ),
                rrb.TimeSeriesView(origin=f"{first}/reward", name="reward"),
                rrb.Tabs(
                    rrb.TextLogView(origin=f"{first}/log", name="log"),
                    rrb.TimeSeriesView(origin=f"{first}/metrics", name="metrics"),
                    rrb.TimeSeriesView(origin=f"{first}/episode", name="episodes"),
                    rrb.TimeSeriesView(origin=f"{first}/actions", name="actions"),
                ),
                row_shares=[2, 1, 1],
            ),
            column_shares=[3, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="sim_time"),
    )
