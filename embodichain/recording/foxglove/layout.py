"""`foxglove_layout.json`: a layout that shows a log at once, in Foxglove and its open forks.

With a viewer's default layout only coordinate axes appear: scenes are hidden until switched on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco

from embodichain.recording.foxglove.joints import Joints

__all__ = ["foxglove_layout"]

_PALETTE = ("#4e98e2", "#f5774d", "#f7df71", "#5cd6a9", "#61cbff", "#a395e2", "#ea4d6c")
_PLOT = {
    "showXAxisLabels": True,
    "showYAxisLabels": True,
    "showLegend": True,
    "legendDisplay": "floating",
    "showPlotValuesInLegend": False,
    "isSynced": True,
    "xAxisVal": "timestamp",
    "sidebarDimension": 240,
}


def foxglove_layout(model: mujoco.MjModel, view_envs: Sequence[int]) -> dict[str, Any]:
    """Return a layout with the scene, joint positions, the reward and the log.

    Args:
        model: The scene's model.
        view_envs: Environments that the log shows.
    """
    topics = {f"/env_{i}/scene": {"visible": True} for i in view_envs}
    first = f"/env_{view_envs[0]}" if view_envs else "/env_0"
    configs: dict[str, Any] = {
        "3D!scene": {
            "followMode": "follow-none",
            "followTf": "world",
            "scene": {"transforms": {"showLabel": False, "axisScale": 0, "lineWidth": 0}},
            "cameraState": {
                "distance": 4.0,
                "perspective": True,
                "phi": 65,
                "thetaOffset": 45,
                "target": [0, 0, 0],
                "targetOffset": [0, 0, 0.8],
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
                    "position": [0, 0, 0],
                    "rotation": [0, 0, 0],
                }
            },
        },
        "Plot!joints": _plot(
            "joint positions (rad, m)",
            [
                f'{first}/joint_states.joints[:]{{name=="{name}"}}.position'
                for name in Joints(model).names
            ],
        ),
        "Plot!reward": _plot("reward", [f"{first}/metrics.reward"]),
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


def _plot(title: str, values: Sequence[str]) -> dict[str, Any]:
    paths = [
        {
            "value": value,
            "enabled": True,
            "timestampMethod": "receiveTime",
            "color": _PALETTE[i % len(_PALETTE)],
        }
        for i, value in enumerate(values)
    ]
    return {**_PLOT, "foxglovePanelTitle": title, "paths": paths}
