"""`GripperCfg` and `HomeCfg`: how a robot's gripper opens, and where its tool is at the start.

With `ArticulationCfg.names`, they say of a robot what a task would else have to know. Pure data.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated

from pydantic import Field

from embodichain.lab.sim.configs.scene_cfg import Quat, Vec3
from embodichain.utils.configclass import configclass

__all__ = ["GripperCfg", "HomeCfg"]

_Command = Annotated[float, Field(allow_inf_nan=False)]


@configclass
class GripperCfg:
    """How a gripper opens and closes: what the action `parallel_gripper` does not give itself."""

    open: _Command | dict[str, _Command] = dataclasses.field(kw_only=True)
    """rad or m, or {joint regex: number}; with `actuators`, units of ctrl."""
    close: _Command | dict[str, _Command] = dataclasses.field(kw_only=True)
    """Likewise."""
    actuators: str | list[str] | None = dataclasses.field(default=None, kw_only=True)
    """Regexes over the names of controls that move it, in place of its joints."""
    force: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = dataclasses.field(
        default=None, kw_only=True
    )
    """Largest force in N, of hinges in N m, that a finger presses with."""


@configclass
class HomeCfg:
    """The pose of a robot's tool at the start, in the environment's frame.

    The joints that move the tool begin near `init_qpos` where the tool has this pose.
    """

    pos: Vec3 = dataclasses.field(kw_only=True)
    """Metres."""
    rot: Vec3 | None = dataclasses.field(default=None, kw_only=True)
    """Euler angles in degrees, intrinsic XYZ; without `rot` and `quat` any orientation will do."""
    quat: Quat | None = dataclasses.field(default=None, kw_only=True)
    """wxyz; overrides `rot`."""
    link: str = dataclasses.field(default="tool", kw_only=True)
    """The tool: a link, site or geom, or one of the robot's `names`."""
