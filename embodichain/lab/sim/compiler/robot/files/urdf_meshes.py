"""`UrdfMeshes`: the meshes of a URDF as files that MuJoCo reads, with colours and textures."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import mujoco

from embodichain.data import DataNotFoundError, resolve_package_uri
from embodichain.lab.sim.compiler.geoms.mesh_conversion import (
    MAX_STL_FACES,
    MadePart,
    convert_collision,
    convert_visual,
    decompose,
    has_materials,
    reads,
)
from embodichain.lab.sim.compiler.geoms.mesh_reading import MeshError
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["UrdfMeshes"]

_INERTIA = mujoco.mjtMeshInertia


@dataclass
class UrdfMeshes:
    """Conversion of a URDF's meshes.

    Attributes:
        path: The URDF.
        convex_parts: Whether collision meshes are split into convex parts.
        looks: OBJ file made from a visual mesh -> its colour and texture.
        shapes: OBJ files made from collision meshes.
        notes: Messages for the user, one line each.
    """

    path: Path
    convex_parts: bool
    looks: dict[str, MadePart] = field(default_factory=dict)
    shapes: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)

    def prepare(self, root: ET.Element) -> None:
        """Replace every mesh by files that MuJoCo reads; a mesh may become several.

        Raises:
            ConfigError: If meshes do not exist, or collision meshes cannot be read.
        """
        missing: dict[str, str] = {}
        unreadable: list[str] = []
        for link in root.iter("link"):
            for kind in ("visual", "collision"):
                what = f"{kind} mesh of link {link.get('name', '')!r}"
                for shape in link.findall(kind):
                    mesh = shape.find("geometry/mesh")
                    if mesh is None:
                        continue
                    uri = mesh.get("filename", "")
                    try:
                        files = self._convert(uri, is_visual=kind == "visual")
                    except DataNotFoundError as error:
                        missing.setdefault(uri, f"{what}: {error}")
                    except (MeshError, OSError, ValueError) as error:
                        # A robot may do without a look, but not without a shape. A ValueError is
                        # a name that cannot be resolved.
                        if kind == "visual" and not isinstance(error, ValueError):
                            link.remove(shape)
                            self.notes.append(f"{what} left out: {error}")
                        else:
                            unreadable.append(f"{what}: {error}")
                    else:
                        _replace_shape(link, shape, files)
        messages = unreadable
        if missing:
            first, *others = missing.values()
            more = f"\n{len(others)} more mesh files are missing" if others else ""
            messages = [f"{first}{more}", *unreadable]
        if messages:
            raise ConfigError([Problem("", f"{self.path}: {message}") for message in messages])

    def finish(self, spec: mujoco.MjSpec) -> None:
        """Set colours of visual meshes, and how MuJoCo computes inertias of meshes."""
        for mesh in spec.meshes:
            if mesh.file in self.looks:
                mesh.inertia = _INERTIA.mjMESH_INERTIA_SHELL  # has no mass; it may be open
            elif mesh.file in self.shapes:
                mesh.inertia = _INERTIA.mjMESH_INERTIA_CONVEX
        files = {mesh.name: mesh.file for mesh in spec.meshes}
        for geom in spec.geoms:
            look = self.looks.get(files.get(geom.meshname, ""))
            if look is not None:
                _color_geom(spec, geom, look)

    def _convert(self, uri: str, is_visual: bool) -> list[Path]:
        """Return the files that take the place of a mesh."""
        path = Path(resolve_package_uri(uri, near=self.path))
        if is_visual:
            return self._convert_visual(path)
        return self._convert_collision(path)

    def _convert_visual(self, path: Path) -> list[Path]:
        if reads(path) and not has_materials(path):
            return [path]
        visual = convert_visual(path)
        self._note_stl(path)
        self.looks.update({str(part.mesh): part for part in visual.parts})
        self.notes += [note for note in visual.notes if note not in self.notes]
        return [part.mesh for part in visual.parts]

    def _convert_collision(self, path: Path) -> list[Path]:
        if self.convex_parts:
            files = list(decompose(path))
        elif reads(path):
            return [path]
        else:
            files = [convert_collision(path)]
            self._note_stl(path)
        self.shapes.update(str(file) for file in files)
        return files

    def _note_stl(self, path: Path) -> None:
        """Add a note that an STL file was converted, once."""
        note = f"{path}: not a binary STL file of at most {MAX_STL_FACES:,} faces: converted"
        if path.suffix.lower() == ".stl" and note not in self.notes:
            self.notes.append(note)


def _replace_shape(link: ET.Element, shape: ET.Element, files: list[Path]) -> None:
    """Replace a shape by one copy per file, in its position."""
    position = list(link).index(shape)
    # The first is the original element, with a known line.
    elements = [shape, *(copy.deepcopy(shape) for _ in files[1:])]
    for number, (file, element) in enumerate(zip(files, elements, strict=True)):
        mesh = element.find("geometry/mesh")
        if mesh is not None:
            mesh.set("filename", str(file))
        if number:
            link.insert(position + number, element)


def _color_geom(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, look: MadePart) -> None:
    """Set the colour and texture of a shape's mesh, which override the URDF's, as in RViz."""
    if look.rgba is not None:
        geom.rgba = look.rgba
        geom.material = ""
    if look.texture is None:
        return
    name = f"{look.mesh.stem}-{look.texture.stem}"
    if spec.material(name) is None:
        texture = spec.texture(look.texture.stem)
        if texture is None:
            texture = spec.add_texture(
                name=look.texture.stem,
                type=mujoco.mjtTexture.mjTEXTURE_2D,
                file=str(look.texture),
            )
        material = spec.add_material(name=name, specular=0.2, shininess=0.3)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
    geom.material = name
    geom.rgba = (1.0, 1.0, 1.0, 1.0)
