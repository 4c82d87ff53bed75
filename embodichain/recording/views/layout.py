"""`foxglove_layout.json`: a layout that shows a log in Foxglove and its open forks.

A viewer's default layout shows coordinate axes only: scenes are hidden until switched on. The part
common to all layouts is ``layout.json``: it preloads transforms, so that poses are right after a
jump in time, and places the grid above the floor, where it does not flicker.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.format.messages.schema import identifier
from embodichain.recording.views.channels import scalar_joints
from embodichain.recording.views.scene import Commands

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["foxglove_layout", "pitch_of", "places"]

_EXTENTS = 2.5
"""Distance between viewed environments, in extents of the scene."""
_MOST_IMAGES = 2
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


def foxglove_layout(
    env: ObservedEnv, view_envs: Sequence[int], images: Sequence[str] = ()
) -> dict[str, Any]:
    """Return a layout with the scene, joint positions, the reward and its terms, and the log.

    Args:
        env: The environment.
        view_envs: Viewed environments.
        images: Topics of pictures; they are shown in the scene, the first `_MOST_IMAGES` also in
            panels.
    """
    text = resources.files(__package__).joinpath("layout.json").read_text("utf-8")
    layout: dict[str, Any] = json.loads(text)
    panels = layout["configById"]
    model = env.sim.engine.model
    has_markers = Commands(env).drawn
    topics: dict[str, Any] = {}
    for env_id in view_envs:
        topics[f"/env_{env_id}/scene"] = {"visible": True}
        if has_markers:
            topics[f"/env_{env_id}/markers"] = {"visible": True}
    panels["3D!scene"]["topics"] = topics
    extent = float(model.stat.extent)
    positions = places(env, view_envs) if view_envs else np.zeros((1, 3))
    spread = float(np.ptp(positions, axis=0).max())
    panels["3D!scene"]["cameraState"] |= {
        "distance": 1.8 * extent + 1.2 * spread,
        "targetOffset": (model.stat.center + positions.mean(axis=0)).tolist(),
    }
    for number, topic in enumerate(images):
        calibration = f"{topic.rpartition('/')[0]}/calibration"
        # The frustum of the camera, with its picture at this distance.
        frustum = {"visible": True, "distance": 0.2 * extent}
        topics[calibration] = frustum
        topics[topic] = frustum
        if number >= _MOST_IMAGES:
            continue
        name = f"Image!{number}"
        panels[name] = {
            "imageMode": {
                "imageTopic": topic,
                "calibrationTopic": calibration,
                # For images of one channel, such as depth in millimetres.
                "colorMode": "colormap",
                "colorMap": "turbo",
                "minValue": 0,
                "maxValue": round(2000.0 * extent),
            }
        }
        layout["layout"]["first"] = {
            "direction": "column",
            "first": layout["layout"]["first"],
            "second": name,
            "splitPercentage": 65,
        }
    first_env = f"/env_{view_envs[0]}" if view_envs else "/env_0"
    panels["Plot!joints"] = _plot("joint positions (rad, m)", _joint_paths(model, first_env))
    manager = getattr(env, "reward_manager", None)  # other classes may have no manager
    terms = [] if manager is None else sorted(manager.terms)
    rewards = {"reward": f"{first_env}/metrics.reward"}
    for name in terms:
        rewards[name] = f"{first_env}/metrics.reward_{identifier(name)}"
    panels["Plot!reward"] = _plot("reward and its terms", rewards)
    return layout


def _joint_paths(model: mujoco.MjModel, env_topic: str) -> dict[str, str]:
    """Message path of each joint's position by its label: `elbow` if only one robot has it."""
    joints = list(scalar_joints(model))
    short_names = [name.rpartition("/")[2] for name in joints]
    paths = {}
    for name, short_name in zip(joints, short_names, strict=True):
        label = short_name if short_names.count(short_name) == 1 else name
        paths[label] = f'{env_topic}/joint_states.joints[:]{{name=="{name}"}}.position'
    return paths


def _plot(title: str, values: Mapping[str, str]) -> dict[str, Any]:
    """Return a plot of message paths by label."""
    paths = [
        {
            "value": value,
            "label": label,
            "color": _PALETTE[i % len(_PALETTE)],
            "enabled": True,
            "timestampMethod": "receiveTime",
        }
        for i, (label, value) in enumerate(values.items())
    ]
    return {
        **_PLOT,
        "foxglovePanelTitle": title,
        "lichtblickPanelTitle": title,  # Foxglove's open fork
        "paths": paths,
    }


def pitch_of(env: ObservedEnv) -> float:
    """Metres between viewed environments, from the scene's size; at most `arena_space`."""
    pitch = _EXTENTS * float(env.sim.engine.model.stat.extent)
    if env.num_envs == 1:
        return pitch
    return min(pitch, float(env.sim.arena_offsets[1, 0]))


def places(env: ObservedEnv, env_ids: Sequence[int]) -> F64:
    """(n, 3) positions of environments in ``world``, in a square, metres."""
    side = max(1, math.ceil(math.sqrt(len(env_ids))))
    index = np.arange(len(env_ids))
    grid = np.stack([index % side, index // side, 0 * index], axis=1)
    return np.asarray(grid * pitch_of(env), np.float64)
