"""Shapes of rigid objects, as pure data; sizes are full sizes in metres."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from embodichain.lab.sim.configs.scene_cfg import Quat, Scale, Vec3
from embodichain.utils.configclass import configclass
from embodichain.utils.fields.defaults import KEEP_DEFAULT, DefaultInt
from embodichain.utils.fields.no_effect import NO_EFFECT, NoEffect
from embodichain.utils.fields.type_errors import member_from_dict
from embodichain.utils.fields.value_checks import are_finite, is_positive, require

__all__ = [
    "AnyShapeCfg",
    "CapsuleCfg",
    "CubeCfg",
    "CylinderCfg",
    "LoadOption",
    "MeshCfg",
    "PlaneCfg",
    "ShapeCfg",
    "SiteCfg",
    "SphereCfg",
    "VariantCfg",
    "VisualMaterialCfg",
]


_MUST_BE_POSITIVE = "must be positive metres, got {}"
Metres = Annotated[float, require(_MUST_BE_POSITIVE, is_positive)]
Edge = Annotated[float, Field(ge=0, allow_inf_nan=False)]


def _are_positive(lengths: list[float]) -> bool:
    return all(map(is_positive, lengths))


def _are_lengths_of_a_plane(lengths: list[float]) -> bool:
    return are_finite(lengths) and min(lengths) >= 0


@configclass
class VisualMaterialCfg:
    """Appearance of a surface. MuJoCo's renderer uses only `base_color`."""

    uid: str = "default_mat"
    base_color: list[float] = [1.0, 1.0, 1.0, 1.0]
    """RGBA in [0, 1]."""
    metallic: float = 0.0
    roughness: float = 0.5
    emissive: list[float] = [0.0, 0.0, 0.0]
    emissive_intensity: float = 1.0
    ior: Annotated[float, NoEffect("MuJoCo's renderer has no refraction")] = 1.5
    """Accepted for compatibility; MuJoCo's renderer has no refraction."""
    textures: list[str] | None = None
    """Image files, or folders of them; None is none. The first is drawn, multiplied with
    `base_color`. The event `randomize_texture` draws one for each environment."""


@configclass
class ShapeCfg:
    """Base of all shapes; `shape_type` names the concrete one."""

    shape_type: str = ""
    visual_material: VisualMaterialCfg | None = None

    @classmethod
    def from_dict(cls, init_dict: dict[str, Any]) -> ShapeCfg:
        """Build the shape that ``init_dict["shape_type"]`` names.

        Raises:
            ConfigError: If the type or a key is unknown; lists what exists.
        """
        return member_from_dict(_SHAPES, "shape_type", init_dict)


@configclass
class CubeCfg(ShapeCfg):
    """A box."""

    shape_type: Literal["Cube"] = "Cube"
    size: Annotated[
        list[float],
        Field(min_length=3, max_length=3),
        require(_MUST_BE_POSITIVE, _are_positive),
    ] = [1.0, 1.0, 1.0]
    """Full edge lengths along x, y, z in metres."""


@configclass
class SphereCfg(ShapeCfg):
    """A ball."""

    shape_type: Literal["Sphere"] = "Sphere"
    radius: Metres = 1.0
    """Metres."""
    resolution: Annotated[int, NoEffect("MuJoCo's sphere is exact")] = 20
    """Accepted for compatibility; MuJoCo's sphere is exact."""


@configclass
class CylinderCfg(ShapeCfg):
    """A cylinder along its z axis."""

    shape_type: Literal["Cylinder"] = "Cylinder"
    radius: Metres = 0.5
    """Metres."""
    height: Metres = 1.0
    """Full height in metres."""


@configclass
class CapsuleCfg(ShapeCfg):
    """A cylinder along z with half-spheres at both ends."""

    shape_type: Literal["Capsule"] = "Capsule"
    radius: Metres = 0.5
    """Metres."""
    height: Metres = 1.0
    """Length of the cylindrical part in metres, without the caps."""


@configclass
class PlaneCfg(ShapeCfg):
    """An infinite plane with normal +z; only for static objects."""

    shape_type: Literal["Plane"] = "Plane"
    size: Annotated[
        list[float],
        Field(min_length=2, max_length=2),
        require(_MUST_BE_POSITIVE, _are_lengths_of_a_plane),
    ] = [0.0, 0.0]
    """Rendered full edge lengths along x, y in metres; 0 is infinite. Collision is infinite."""


@configclass
class LoadOption:
    """How a mesh file is read. Accepted for compatibility; MuJoCo's importer decides."""

    rebuild_normals: bool = False
    rebuild_tangent: bool = False
    rebuild_3rdparty_normals: bool = False
    rebuild_3rdparty_tangent: bool = False
    smooth: float = -1.0


@configclass
class MeshCfg(ShapeCfg):
    """A mesh file. Its hull or convex parts collide (`RigidObjectCfg.collision`)."""

    shape_type: Literal["Mesh"] = "Mesh"
    fpath: str = ""
    """A .obj, .stl, .dae, .glb, .gltf, .ply, .off or .msh file, found by
    `embodichain.data.get_data_path`. Coordinates are in metres; a .dae file's unit and up axis are
    applied. Its colours are drawn unless `visual_material` is given."""
    load_option: Annotated[LoadOption, NoEffect("MuJoCo's importer reads the mesh")] = LoadOption()
    compute_uv: Annotated[bool, NO_EFFECT] = False
    """Accepted for compatibility."""
    project_direction: Annotated[list[float], NO_EFFECT] = [1.0, 1.0, 1.0]
    """Accepted for compatibility."""


_SHAPES: dict[str, type[ShapeCfg]] = {
    "Cube": CubeCfg,
    "Sphere": SphereCfg,
    "Cylinder": CylinderCfg,
    "Capsule": CapsuleCfg,
    "Plane": PlaneCfg,
    "Mesh": MeshCfg,
}

AnyShapeCfg = Annotated[
    CubeCfg | SphereCfg | CylinderCfg | CapsuleCfg | PlaneCfg | MeshCfg,
    Field(discriminator="shape_type"),
]
"""The union that YAML is checked against; `shape_type` selects the member."""


@configclass
class SiteCfg:
    """A named place on an object: where to grasp it, its inside, its upper face."""

    pos: Vec3 = (0.0, 0.0, 0.0)
    """Metres: its middle in the object's frame."""
    rot: Vec3 = (0.0, 0.0, 0.0)
    """Euler angles in degrees, intrinsic XYZ, in the object's frame."""
    quat: Quat | None = None
    """wxyz; overrides `rot`."""
    size: Annotated[list[Edge], Field(min_length=3, max_length=3)] | None = None
    """Full edge lengths of the box that it marks, metres; None marks a point."""


@configclass
class VariantCfg:
    """One of the shapes that an object may have in an environment; see `any_of`."""

    shape: AnyShapeCfg = CubeCfg()
    pos: Vec3 = (0.0, 0.0, 0.0)
    """Metres: the shape's origin in the object's frame."""
    rot: Vec3 = (0.0, 0.0, 0.0)
    """Euler angles in degrees, intrinsic XYZ, in the object's frame."""
    quat: Quat | None = None
    """wxyz; overrides `rot`."""
    mass: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """kg; 0 computes it from the density; None is that of the object's `attrs`."""
    density: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """kg/m^3; None is that of the object's `attrs`."""
    dynamic_friction: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """None is that of the object's `attrs`."""
    body_scale: Scale = (1.0, 1.0, 1.0)
    """As of an object."""
    max_convex_hull_num: Annotated[int, Field(ge=1), KEEP_DEFAULT] = DefaultInt(1)
    """As of an object."""
    collision: Literal["hull", "decompose", "pieces"] = "hull"
    """As of an object."""
