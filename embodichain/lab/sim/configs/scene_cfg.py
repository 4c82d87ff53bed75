"""Configs of surroundings: ground, terrain, sky, lights, furniture, camera views. Pure data.

`ObjectBaseCfg` and the vector types that the configs of entities share are here too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from embodichain.lab.sim.configs.contact_cfg import ContactCfg
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem
from embodichain.utils.fields.no_effect import NoEffect
from embodichain.utils.fields.value_checks import are_finite, is_not_zero, require

__all__ = [
    "DEFAULT_VIEW",
    "AnyPatchCfg",
    "BlocksPatchCfg",
    "FlatPatchCfg",
    "Four",
    "GapsPatchCfg",
    "GroundCfg",
    "LightCfg",
    "ObjectBaseCfg",
    "PatchCfg",
    "PedestalCfg",
    "Quat",
    "RoughPatchCfg",
    "SceneCfg",
    "SkyCfg",
    "SlopePatchCfg",
    "StairsPatchCfg",
    "StonesPatchCfg",
    "TableCfg",
    "TerrainCfg",
    "Vec3",
    "ViewCfg",
    "WavesPatchCfg",
]

Vec3 = Annotated[
    Sequence[float],
    Field(min_length=3, max_length=3),
    require("must be 3 finite numbers, got {}", are_finite),
]
Direction3 = Annotated[Vec3, require("must not be zero, got {}", is_not_zero)]
Scale = Annotated[Vec3, require("must be 3 positive numbers, got {}", lambda scale: min(scale) > 0)]
Four = Annotated[
    Sequence[float],
    Field(min_length=4, max_length=4),
    require("must be 4 finite numbers, got {}", are_finite),
]
Quat = Four
Orientation = Annotated[Quat, require("must not be zero: it is a rotation, wxyz", is_not_zero)]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Rgb = Annotated[Sequence[Share], Field(min_length=3, max_length=3)]
Box = Annotated[Sequence[Length], Field(min_length=3, max_length=3)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Point = Annotated[Sequence[Finite], Field(min_length=3, max_length=3)]


def is_color(rgb: Sequence[float]) -> bool:
    """Whether all shares of a colour are within 0 and 1."""
    return all(0 <= share <= 1 for share in rgb)


_VIEW_PLACES = ("eye", "direction", "camera")
"""Keys of a view that say where it is."""
DEFAULT_VIEW = "default"
"""The view that every scene has."""


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
    color: Annotated[Vec3, require("RGB in [0, 1], got {}", is_color)] = (1.0, 1.0, 1.0)
    """RGB in [0, 1]."""
    intensity: Annotated[float, require("must not be negative, got {}", lambda x: x >= 0)] = 30.0
    """Relative brightness; 30 is MuJoCo's full diffuse colour."""
    direction: Direction3 = (0.0, 0.0, -1.0)
    """The direction in which a spot or directional light shines."""
    radius: Annotated[float, NoEffect("MuJoCo's lights have no falloff radius")] = 1e2
    """No effect: MuJoCo's lights have no falloff radius."""
    # ours
    shadow: bool | None = dataclasses.field(default=None, kw_only=True)
    """Whether it casts shadows; None: all but point lights do."""
    cutoff: Annotated[float, Field(gt=0, le=90)] = dataclasses.field(default=45.0, kw_only=True)
    """Half of a spot's opening angle in degrees."""


@configclass
class GroundCfg(ContactCfg):
    """The ground plane at z = 0, entity ``default_plane``.

    Without `friction` its priority is -1: what stands on it decides. With it the priority is 0 and
    a contact has the larger friction of the two; with ``priority: 1`` the ground decides.
    """

    type: Literal["checker", "grid", "wood", "plain", "none"] = "checker"
    """``none``: there is no ground, for collisions neither."""
    colors: Annotated[list[Rgb], Field(min_length=1, max_length=2)] | None = None
    """RGB in [0, 1]: of both tiles, of a grid's tiles and lines, of light and dark wood; the first
    alone of ``plain``."""
    tile: Length = 1.0
    """Metres: edge of a tile, length of a plank. A grid has finer lines at the fifths of a tile,
    whose middle is at the origin."""
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
class TableCfg(ContactCfg):
    """A static table, entity ``table``: its pose is that of the middle of its top.

    It touches others as the ground does, see `GroundCfg`.
    """

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


@configclass
class PedestalCfg(ContactCfg):
    """A static column below a robot's base, entity ``pedestal``.

    It touches others as the ground does, see `GroundCfg`.
    """

    shape: Literal["cylinder", "box"] = "cylinder"
    size: Box | None = None
    """Metres along x, y and z; None is 0.2 x 0.2 and the height of the robot's base above `pos`."""
    pos: Point | None = None
    """Metres: the middle of its footprint; None is the ground below the robot's base."""
    color: Rgb = (0.3, 0.32, 0.35)
    """RGB in [0, 1]."""
    collision: bool = True


Ends = Annotated[
    Sequence[Annotated[float, Field(ge=0, allow_inf_nan=False)]], Field(min_length=2, max_length=2)
]
"""A value at the lowest and one at the highest level; linear between them."""
Count = Annotated[int, Field(ge=1)]
Direction = Literal["up", "down"]
"""Whether the ground rises or falls from the middle of a patch to its edge, where it is 0."""


@configclass
class PatchCfg:
    """Base of the kinds of patches; `type` names the concrete one."""

    type: str = ""
    columns: Count = 1
    """How many columns of patches are of this kind."""


@configclass
class FlatPatchCfg(PatchCfg):
    """Flat ground at height 0."""

    type: Literal["flat"] = "flat"


@configclass
class RoughPatchCfg(PatchCfg):
    """Random heights on a grid, with linear interpolation between them."""

    type: Literal["rough"] = "rough"
    height: Ends = (0.02, 0.1)
    """Metres: the largest height and depth."""
    spacing: Length = 0.2
    """Metres between two heights."""


@configclass
class SlopePatchCfg(PatchCfg):
    """A pyramid without its top, or a pit of the same form."""

    type: Literal["slope"] = "slope"
    slope: Ends = (0.0, 0.4)
    """Rise over run."""
    direction: Direction = "up"


@configclass
class StairsPatchCfg(PatchCfg):
    """Square stairs around the middle."""

    type: Literal["stairs"] = "stairs"
    step_height: Ends = (0.05, 0.2)
    """Metres."""
    step_depth: Length = 0.3
    """Metres."""
    direction: Direction = "up"


@configclass
class WavesPatchCfg(PatchCfg):
    """A product of two sine waves, along x and along y."""

    type: Literal["waves"] = "waves"
    height: Ends = (0.02, 0.15)
    """Metres: the amplitude."""
    count: Count = 3
    """Waves along an edge."""


@configclass
class BlocksPatchCfg(PatchCfg):
    """Square blocks side by side, each with a random height."""

    type: Literal["blocks"] = "blocks"
    height: Ends = (0.03, 0.15)
    """Metres: the height of the highest; the lowest is 0."""
    size: Length = 0.45
    """Metres: edge of a block."""


@configclass
class StonesPatchCfg(PatchCfg):
    """Square stepping stones, each with a random height."""

    type: Literal["stepping_stones"] = "stepping_stones"
    size: Ends = (0.9, 0.4)
    """Metres: edge of a stone."""
    gap: Ends = (0.1, 0.3)
    """Metres between two stones."""
    height: Ends = (0.0, 0.05)
    """Metres: the largest height and depth of a stone's top."""
    depth: Length = 0.5
    """Metres: of the gaps."""


@configclass
class GapsPatchCfg(PatchCfg):
    """Square ditches around the middle, with flat ground between them."""

    type: Literal["gaps"] = "gaps"
    width: Ends = (0.1, 0.5)
    """Metres: of a ditch."""
    land: Length = 0.8
    """Metres between two ditches."""
    depth: Length = 0.5
    """Metres."""


AnyPatchCfg = Annotated[
    FlatPatchCfg
    | RoughPatchCfg
    | SlopePatchCfg
    | StairsPatchCfg
    | WavesPatchCfg
    | BlocksPatchCfg
    | StonesPatchCfg
    | GapsPatchCfg,
    Field(discriminator="type"),
]
"""The union that YAML is checked against; `type` selects the member."""


@configclass
class TerrainCfg(ContactCfg):
    """Rough ground from square patches, instead of the ground plane; entity ``default_plane``.

    Rows along x are levels of difficulty, columns along y are kinds. It is one height field, so
    vertical walls, such as those of steps, are as steep as the resolution allows. An environment
    is on its first patch unless the event `place_terrain` chooses another. It touches others as the
    ground does, see `GroundCfg`.
    """

    patches: Annotated[dict[str, AnyPatchCfg], Field(min_length=1)]
    """The kinds, by name."""
    levels: Count = 5
    size: Length = 8.0
    """Metres: edge of a patch."""
    platform: Length = 1.5
    """Metres: edge of the flat square in the middle of a patch, where episodes start."""
    border: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 4.0
    """Metres of flat ground around all patches; there is nothing beyond it."""
    resolution: Length = 0.1
    """Metres between two heights."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of random heights; the run's seed does not change the terrain."""


@configclass
class SceneCfg:
    """What surrounds the robots and objects of a task."""

    fpath: str | None = None
    """An MJCF file: its bodies, lights, cameras and materials; the ground is then its own."""
    keyframe: str | None = None
    """The file's keyframe with the initial state; None is ``home``, else the first, if any."""
    ground: GroundCfg | None = None
    """None is a checker, or no ground if there is a file."""
    terrain: TerrainCfg | None = None
    """Rough ground instead of the plane, in the colours of `ground`."""
    sky: SkyCfg | None = None
    """None is the file's, else the default sky."""
    ambient: Share | None = None
    """Light from everywhere, 0 to 1; None is the file's, else 0.33."""
    headlight: Share | None = None
    """Light from the camera, 0 to 1; None is the file's, else 0.38."""
    sun: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Strength of the sun that shines where there are no lights; None is 1. Less makes shadows
    softer, with more of `ambient` instead."""
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
    direction: Annotated[Point, require("must not be zero, got {}", is_not_zero)] | None = None
    """From the scene to the camera, which is as far away as needed to show robots and objects."""
    show: Annotated[list[str], Field(min_length=1)] | None = None
    """With `direction`, the entities that fill the picture; None is all of them."""
    margin: Annotated[float, Field(ge=1, allow_inf_nan=False)] | None = None
    """With `direction`, the width of the picture over that of what it shows; None is 1.2."""
    camera: str | None = None
    """A camera of a robot's file, ``uid/NAME``, or of the scene's, ``scene/NAME``."""
    target: Point | None = None
    """The point it looks at; None is the middle of robots and objects, or of `body`."""
    up: Annotated[Point, require("must not be zero, got {}", is_not_zero)] = (0.0, 0.0, 1.0)
    """The picture's upward direction."""
    fovy: Annotated[float, Field(gt=0, lt=180)] | None = None
    """Vertical field of view in degrees; None is 40, or the camera's."""
    body: str | None = None
    """An entity, or a link, site or geom of one, ``uid/NAME``, that it follows; `eye` and `target`
    are relative to it."""
    follow: Literal["position", "pose"] = "position"
    """``position``: the view does not turn with `body`. ``pose``: it is fixed on it, and `eye` and
    `target` are in its frame."""

    def check(self) -> list[Problem]:
        """Return the mistakes of values that do not go together, with paths below it."""
        places = [name for name in _VIEW_PLACES if getattr(self, name) is not None]
        if len(places) != 1:
            got = " and ".join(places) or "none"
            return [Problem("", f"needs one of {', '.join(_VIEW_PLACES)}, got {got}")]
        if self.camera is not None:
            problems = self._check_camera()
        elif self.direction is not None:
            problems = self._check_direction()
        else:
            problems = self._check_eye()
        problems += self._check_show()
        if self.follow != "position" and self.body is None:
            problems.append(Problem("follow", "belongs to body: the view follows nothing"))
        return problems

    def _check_camera(self) -> list[Problem]:
        """A camera of a file has its own pose."""
        message = "has no effect on a camera of a file: leave it out"
        keys = [name for name in ("target", "body") if getattr(self, name) is not None]
        if tuple(self.up) != ViewCfg.up:
            keys.append("up")
        return [Problem(key, message) for key in keys]

    def _check_show(self) -> list[Problem]:
        """Only a camera whose distance is computed fills its picture with something."""
        if self.direction is not None:
            return []
        message = "needs direction: only then the distance is computed"
        keys = [name for name in ("show", "margin") if getattr(self, name) is not None]
        return [Problem(key, message) for key in keys]

    def _check_direction(self) -> list[Problem]:
        """A distance that shows the whole scene has no meaning beside one body."""
        if self.body is None:
            return []
        return [Problem("body", "needs eye, relative to the body, not direction")]

    def _check_eye(self) -> list[Problem]:
        """Without a target and a body, the camera looks at the middle of the scene."""
        if self.target is None and self.body is None:
            return []
        target = (0.0, 0.0, 0.0) if self.target is None else self.target
        if self.eye is None or not np.allclose(self.eye, target):
            return []
        message = f"the camera is at the point it looks at, {[float(x) for x in self.eye]}"
        return [Problem("eye", message)]
