"""Configs of what a scene looks like: ground, sky, lights, furniture, camera views. Pure data.

`ObjectBaseCfg` and the vector types that the configs of entities share are here too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from embodichain.utils.configclass import configclass

__all__ = [
    "Four",
    "GroundCfg",
    "LightCfg",
    "ObjectBaseCfg",
    "PedestalCfg",
    "Quat",
    "SceneCfg",
    "SkyCfg",
    "TableCfg",
    "Vec3",
    "ViewCfg",
]

Vec3 = Annotated[Sequence[float], Field(min_length=3, max_length=3)]
Four = Annotated[Sequence[float], Field(min_length=4, max_length=4)]
Quat = Four
Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Rgb = Annotated[Sequence[Share], Field(min_length=3, max_length=3)]
Box = Annotated[Sequence[Length], Field(min_length=3, max_length=3)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Point = Annotated[Sequence[Finite], Field(min_length=3, max_length=3)]


@configclass
class ObjectBaseCfg:
    """Name and initial pose of anything in a scene."""

    uid: str | None = None
    init_pos: Vec3 = (0.0, 0.0, 0.0)
    """Metres, in the environment's own frame."""
    init_rot: Vec3 = (0.0, 0.0, 0.0)
    """Euler angles in degrees, intrinsic XYZ (R = Rx Ry Rz)."""
    init_local_pose: Any = None
    """A 4x4 matrix; overrides `init_pos` and `init_rot`."""
    # ours
    init_quat: Quat | None = dataclasses.field(default=None, kw_only=True)
    """wxyz; overrides `init_rot`."""


@configclass
class LightCfg(ObjectBaseCfg):
    """A light for rendering; physics ignores it."""

    light_type: Literal["point", "sun", "direction", "directional", "spot"] = "point"
    """``sun`` and ``direction`` are EmbodiChain's names for ``directional``."""
    color: Vec3 = (1.0, 1.0, 1.0)
    """RGB in [0, 1]."""
    intensity: float = 30.0
    """Relative brightness; 30 is MuJoCo's full diffuse colour."""
    direction: Vec3 = (0.0, 0.0, -1.0)
    """The direction in which a spot or directional light shines."""
    radius: float = 1e2
    """No effect: MuJoCo's lights have no falloff radius."""
    # ours
    shadow: bool | None = dataclasses.field(default=None, kw_only=True)
    """Whether it casts shadows; None: all but point lights do."""
    cutoff: Annotated[float, Field(gt=0, le=90)] = dataclasses.field(default=45.0, kw_only=True)
    """Half of a spot's opening angle in degrees."""


@configclass
class GroundCfg:
    """The ground plane at z = 0, entity ``default_plane``."""

    type: Literal["checker", "wood", "plain", "none"] = "checker"
    """``none``: there is no ground, for collisions neither."""
    colors: Annotated[list[Rgb], Field(min_length=1, max_length=2)] | None = None
    """RGB in [0, 1]: of both tiles, of light and dark wood; the first alone of ``plain``."""
    tile: Length = 1.0
    """Metres: edge of a tile, length of a plank."""
    size: Length | None = None
    """Metres: edge of the drawn square around the origin; None is endless, as collisions are."""
    reflectance: Share = 0.0
    """Share of mirrored light; a mirror draws the scene twice."""


@configclass
class SkyCfg:
    """A gradient behind everything."""

    top: Rgb = (0.42, 0.56, 0.72)
    """RGB in [0, 1] overhead."""
    horizon: Rgb = (0.86, 0.90, 0.94)
    """RGB in [0, 1] at the horizon."""


@configclass
class TableCfg:
    """A static table, entity ``table``: its pose is that of the middle of its top."""

    size: Box = (1.2, 0.8, 0.75)
    """Metres along x, y and z; z is the height of its surface above `pos`."""
    pos: Point = (0.0, 0.0, 0.0)
    """Metres: the middle of its footprint."""
    thickness: Length = 0.04
    """Metres: of the top."""
    type: Literal["wood", "plain"] = "wood"
    color: Rgb = (0.9, 0.83, 0.71)
    """RGB in [0, 1] of the top."""
    collision: bool = True
    friction: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.5
    """Sliding friction."""


@configclass
class PedestalCfg:
    """A static column below a robot's base, entity ``pedestal``."""

    shape: Literal["cylinder", "box"] = "cylinder"
    size: Box | None = None
    """Metres along x, y and z; None is 0.2 x 0.2 and the height of the robot's base above `pos`."""
    pos: Point | None = None
    """Metres: the middle of its footprint; None is the ground below the robot's base."""
    color: Rgb = (0.3, 0.32, 0.35)
    """RGB in [0, 1]."""
    collision: bool = True


@configclass
class SceneCfg:
    """What surrounds the robots and objects of a task."""

    fpath: str | None = None
    """An MJCF file: its bodies, lights, cameras and materials; the ground is then its own."""
    keyframe: str | None = None
    """The file's keyframe with the initial state; None is ``home``, else the first, if any."""
    ground: GroundCfg | None = None
    """None is a checker, or no ground if there is a file."""
    sky: SkyCfg | None = None
    """None is the file's, else the default sky."""
    ambient: Share | None = None
    """Light from everywhere, 0 to 1; None is the file's, else 0.33."""
    headlight: Share | None = None
    """Light from the camera, 0 to 1; None is the file's, else 0.38."""
    lights: dict[str, LightCfg] = {}
    """As the task's section `lights`. If neither has any, nor the file, a sun shines."""
    table: TableCfg | None = None
    pedestal: PedestalCfg | None = None


@configclass
class ViewCfg:
    """A named camera view. One of `eye`, `direction` and `camera` says where it is.

    Views are cameras of the compiled model, so everything that takes a camera's name takes theirs.
    The view ``default`` replaces the one that is computed.
    """

    eye: Point | None = None
    """Metres."""
    direction: Point | None = None
    """From the scene to the camera, which is as far away as needed to show robots and objects."""
    camera: str | None = None
    """A camera of a robot's file, ``uid/NAME``, or of the scene's, ``scene/NAME``."""
    target: Point | None = None
    """The point it looks at; None is the middle of robots and objects, or of `body`."""
    up: Point = (0.0, 0.0, 1.0)
    """The picture's upward direction."""
    fovy: Annotated[float, Field(gt=0, lt=180)] | None = None
    """Vertical field of view in degrees; None is 40, or the camera's."""
    body: str | None = None
    """An entity, or ``uid/LINK``, that it follows; `eye` and `target` are relative to it."""
    follow: Literal["position", "pose"] = "position"
    """``position``: the view does not turn with `body`. ``pose``: it is fixed on it, and `eye` and
    `target` are in its frame."""
