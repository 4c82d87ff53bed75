"""`foxglove_layout.json`: a layout that shows a log at once, in Foxglove and its open forks.

With a viewer's default layout only coordinate axes appear: scenes are hidden until switched on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.recording.foxglove.commands import Commands
from embodichain.recording.foxglove.joints import Joints
from embodichain.recording.foxglove.places import places
from embodichain.recording.foxglove.scalars import identifier

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["foxglove_layout"]

_PALETTE = ("#4e98e2", "#f5774d", "#f7df71", "#5cd6a9", "#61cbff", "#a395e2", "#ea4d6c")
_PLOT = {
    "showXAxisLabels": True,
    "showYAxisLabels": True,
    "showLegend": True,
    "legendDisplay": "left",
    "showPlotValuesInLegend": False,
    "isSynced": True,
    "xAxisVal": "timestamp",
    "sidebarDimension": 150,
}
_ABOVE_FLOOR = 0.002
"""Metres; a grid in the very plane of the floor flickers."""


def foxglove_layout(env: ObservedEnv, view_envs: Sequence[int]) -> dict[str, Any]:
    """Return a layout with the scene, joint positions, the reward with its terms, and the log.

    Args:
        env: The environment.
        view_envs: Environments that the log shows.
    """
    model = env.sim.engine.model
    drawn = ("scene", "markers") if Commands(env, view_envs).markers else ("scene",)
    seen = [f"/env_{i}/{name}" for i in view_envs for name in drawn]
    topics = {topic: {"visible": True} for topic in seen}
    where = places(env, view_envs) if view_envs else np.zeros((1, 3))
    spread = float(np.ptp(where, axis=0).max())
    first = f"/env_{view_envs[0]}" if view_envs else "/env_0"
    configs: dict[str, Any] = {
        "3D!scene": {
            "followMode": "follow-none",
            "followTf": "world",
            "scene": {
                "transforms": {
                    "showLabel": False,
                    "axisScale": 0,
                    "lineWidth": 0,
                    "enablePreloading": True,  # right poses after a jump in time
                }
            },
            "cameraState": {
                "distance": 1.8 * float(model.stat.extent) + 1.2 * spread,
                "perspective": True,
                "phi": 65,
                "thetaOffset": 135,
                "target": [0, 0, 0],
                "targetOffset": (model.stat.center + where.mean(axis=0)).tolist(),
                "targetOrientation": [0, 0, 0, 1],
                "fovy": 45,
                "near": 0.05,
                "far": 500,
            },
            "topics": topics,
            "layers": {
                "grid": {
                    "layerId": "foxglove.Grid",
                    "instanceId": "grid",
                    "label": "Grid",
                    "visible": True,
                    "frameId": "world",
                    "size": 10,
                    "divisions": 10,
                    "lineWidth": 1,
                    "color": "#248eff66",
                    "position": [0, 0, _ABOVE_FLOOR],
                    "rotation": [0, 0, 0],
                }
            },
        },
        "Plot!joints": _plot(
            "joint positions (rad, m)",
            {
                label: f'{first}/joint_states.joints[:]{{name=="{name}"}}.position'
                for name, label in _short(Joints(model).names).items()
            },
        ),
        "Plot!reward": _plot("reward and its terms", _rewards(env, first)),
        "RosOut!log": {"searchTerms": [], "minLogLevel": 1, "topicToRender": "/log"},
    }
    return {
        "configById": configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": "3D!scene",
            "second": {
                "direction": "column",
                "first": "Plot!joints",
                "second": {
                    "direction": "column",
                    "first": "Plot!reward",
                    "second": "RosOut!log",
                    "splitPercentage": 60,
                },
                "splitPercentage": 45,
            },
            "splitPercentage": 62,
        },
    }


def _short(names: Sequence[str]) -> dict[str, str]:
    """Names with what tells them apart: `arm/elbow` is `elbow` where only an arm has one."""
    last = [name.rpartition("/")[2] for name in names]
    pairs = zip(names, last, strict=True)
    return {name: tail if last.count(tail) == 1 else name for name, tail in pairs}


def _rewards(env: ObservedEnv, first: str) -> dict[str, str]:
    """Paths of the reward and of its terms, by label."""
    manager = getattr(env, "reward_manager", None)  # environments of others may have none
    terms = [] if manager is None else sorted(manager.terms)
    paths = {name: f"{first}/metrics.reward_{identifier(name)}" for name in terms}
    return {"reward": f"{first}/metrics.reward", **paths}


def _plot(title: str, values: Mapping[str, str]) -> dict[str, Any]:
    """A plot of message paths by label."""
    paths = [
        {
            "value": value,
            "label": label,
            "enabled": True,
            "timestampMethod": "receiveTime",
            "color": _PALETTE[i % len(_PALETTE)],
        }
        for i, (label, value) in enumerate(values.items())
    ]
    # Foxglove's key, and that of its open fork Lichtblick.
    titles = {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}
    return {**_PLOT, **titles, "paths": paths}
