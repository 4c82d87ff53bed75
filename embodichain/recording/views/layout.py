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

import numpy as np

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.views.channels import identifier, scalar_joints
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
    drawn = ("scene", "markers") if Commands(env).drawn else ("scene",)
    topics = [f"/env_{i}/{name}" for i in view_envs for name in drawn]
    panels["3D!scene"]["topics"] = {topic: {"visible": True} for topic in topics}
    extent = float(model.stat.extent)
    where = places(env, view_envs) if view_envs else np.zeros((1, 3))
    spread = float(np.ptp(where, axis=0).max())
    panels["3D!scene"]["cameraState"] |= {
        "distance": 1.8 * extent + 1.2 * spread,
        "targetOffset": (model.stat.center + where.mean(axis=0)).tolist(),
    }
    for number, topic in enumerate(images):
        calibration = f"{topic.rpartition('/')[0]}/calibration"
        # The frustum of the camera, with its picture at this distance.
        shown = {"visible": True, "distance": 0.2 * extent}
        panels["3D!scene"]["topics"] |= {calibration: shown, topic: shown}
        if number >= _MOST_IMAGES:
            continue
        name = f"Image!{number}"
        # Viewers use these colours for images of one channel, such as depth in millimetres.
        colors = {"colorMode": "colormap", "colorMap": "turbo", "minValue": 0}
        of = {"imageTopic": topic, "calibrationTopic": calibration}
        panels[name] = {"imageMode": {**of, **colors, "maxValue": round(2000.0 * extent)}}
        split = {"direction": "column", "first": layout["layout"]["first"], "second": name}
        layout["layout"]["first"] = {**split, "splitPercentage": 65}
    first = f"/env_{view_envs[0]}" if view_envs else "/env_0"
    joints = list(scalar_joints(model))
    last = [name.rpartition("/")[2] for name in joints]  # `elbow` if only one robot has it
    labels = [tail if last.count(tail) == 1 else n for n, tail in zip(joints, last, strict=True)]
    paths = [f'{first}/joint_states.joints[:]{{name=="{n}"}}.position' for n in joints]
    named = dict(zip(labels, paths, strict=True))
    panels["Plot!joints"] = _plot("joint positions (rad, m)", named)
    manager = getattr(env, "reward_manager", None)  # other classes may have no manager
    terms = [] if manager is None else sorted(manager.terms)
    named = {name: f"{first}/metrics.reward_{identifier(name)}" for name in terms}
    named = {"reward": f"{first}/metrics.reward", **named}
    panels["Plot!reward"] = _plot("reward and its terms", named)
    return layout


def _plot(title: str, values: Mapping[str, str]) -> dict[str, Any]:
    """Return a plot of message paths by label."""
    common = {"enabled": True, "timestampMethod": "receiveTime"}
    paths = [
        {"value": value, "label": label, "color": _PALETTE[i % len(_PALETTE)], **common}
        for i, (label, value) in enumerate(values.items())
    ]
    # Foxglove's key, and that of its open fork Lichtblick.
    titles = {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}
    return {**_PLOT, **titles, "paths": paths}


def pitch_of(env: ObservedEnv) -> float:
    """Metres between viewed environments, from the scene's size; at most `arena_space`."""
    pitch = _EXTENTS * float(env.sim.engine.model.stat.extent)
    return pitch if env.num_envs == 1 else min(pitch, float(env.sim.arena_offsets[1, 0]))


def places(env: ObservedEnv, env_ids: Sequence[int]) -> F64:
    """(n, 3) positions of environments in ``world``, in a square, metres."""
    side = max(1, math.ceil(math.sqrt(len(env_ids))))
    index = np.arange(len(env_ids))
    grid = np.stack([index % side, index // side, 0 * index], axis=1)
    found: F64 = np.asarray(grid * pitch_of(env), np.float64)
    return found
