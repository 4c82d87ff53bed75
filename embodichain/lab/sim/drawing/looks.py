"""`SurfaceTable`: sizes, colours, materials and textures of every geom of every environment."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.geometry import geom_scales
from embodichain.lab.sim.drawing.views import DrawnState

__all__ = ["SurfaceTable", "Unchanged", "opaque_geoms"]

_DEFAULT_COLOUR = np.array([0.5, 0.5, 0.5, 1.0])
_DEFAULT_FINISH = 0.5, 0.5, 0.0
"""MuJoCo's specular, shininess and emission of a geom without a material."""
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_FIELDS = {"geom_size": 3, "geom_rgba": 4, "geom_matid": 0}
_MATERIAL_FIELDS = {
    "mat_rgba": 4,
    "mat_specular": 0,
    "mat_shininess": 0,
    "mat_emission": 0,
    "mat_texid": int(mujoco.mjtTextureRole.mjNTEXROLE),
    "mat_texrepeat": 2,
    "mat_texuniform": 0,
}


class Unchanged:
    """Tells whether arrays are what they were before."""

    def __init__(self) -> None:
        self._before: list[NDArray[Any]] = []

    def __call__(self, arrays: list[NDArray[Any]]) -> bool:
        """Compare with the arrays of the last call, and keep copies of these."""
        if len(arrays) == len(self._before) and all(map(np.array_equal, arrays, self._before)):
            return True
        self._before = [np.array(array) for array in arrays]
        return False


class SurfaceTable:
    """What surfaces look like; computed again when a model field differs from the last call's.

    Args:
        model: The compiled scene.
        texture_layers: (ntex, 2) see `SceneTextures`.

    Attributes:
        table: (N or 1, ngeom, 4, 4) float32: scale along x, y, z (0: no edge) and half length;
            colour; specular, shininess, emission and the texture among the squares, -1 without;
            how often it repeats along u and v, the texture among the cubes, 1 if a geom's size
            multiplies the repeats.
        textured: (ngeom, 2) bool: geoms with a square or a cube in any environment.
        transparent: (ngeom,) bool: geoms that light passes in any environment.
    """

    def __init__(self, model: mujoco.MjModel, texture_layers: NDArray[np.int64]) -> None:
        self._model = model
        self._layers = texture_layers
        # Field -> its width, 0 of one that has a number for each geom.
        self._fields = _FIELDS | _MATERIAL_FIELDS if model.nmat else _FIELDS
        self._same = Unchanged()
        self.table = np.zeros((0, 0, 4, 4), np.float32)
        self.textured: NDArray[Any] = np.zeros((0, 2), bool)
        self.transparent: NDArray[Any] = np.zeros(0, bool)

    def update(self, state: DrawnState) -> None:
        """Compute it for all environments of a state, if a field changed."""
        values = {name: state.model_values(name) for name in self._fields}
        if self._same(list(values.values())):
            return
        count = max(len(value) for value in values.values())
        fields: dict[str, NDArray[Any]] = {}
        for name, width in self._fields.items():
            value: NDArray[Any] = values[name].reshape(len(values[name]), -1)
            if width:
                value = value.reshape(len(value), -1, width)
            fields[name] = np.broadcast_to(value, (count, *value.shape[1:]))
        table = np.zeros((count, self._model.ngeom, 4, 4), np.float32)
        table[..., 0, :] = geom_scales(self._model.geom_type, fields["geom_size"])
        table[..., 1, :] = fields["geom_rgba"]
        table[..., 2, :3] = _DEFAULT_FINISH
        table[..., 2, 3] = -1.0
        table[..., 3, 2] = -1.0
        if self._model.nmat:
            self._put_materials(fields, table)
        self.table = table
        self.textured = np.any(table[..., (2, 3), (3, 2)] >= 0, axis=0)
        alpha = table[..., 1, 3]
        self.transparent = np.any((alpha > 0) & (alpha < 1), axis=0)

    def _put_materials(self, fields: dict[str, Any], table: NDArray[np.float32]) -> None:
        """Overwrite the defaults of geoms that have a material."""
        env, geom = np.nonzero(fields["geom_matid"] >= 0)
        material = fields["geom_matid"][env, geom]
        colour = fields["mat_rgba"][env, material]
        table[env, geom, 1] = _shown_colour(fields["geom_rgba"][env, geom], colour)
        table[env, geom, 2, 0] = fields["mat_specular"][env, material]
        table[env, geom, 2, 1] = fields["mat_shininess"][env, material]
        table[env, geom, 2, 2] = fields["mat_emission"][env, material]

        # Of these, geoms whose material has a texture.
        texture = fields["mat_texid"][env, material, _RGB]
        has_texture = texture >= 0
        texture = texture[has_texture]
        env = env[has_texture]
        geom = geom[has_texture]
        material = material[has_texture]
        repeat = fields["mat_texrepeat"][env, material]
        uniform = fields["mat_texuniform"][env, material]
        table[env, geom, 2, 3] = self._layers[texture, 0]
        table[env, geom, 3, 2] = self._layers[texture, 1]
        table[env, geom, 3, :2] = repeat
        table[env, geom, 3, 3] = uniform


def opaque_geoms(state: DrawnState, model: mujoco.MjModel) -> NDArray[np.bool_]:
    """(N or 1, ngeom) bool: geoms without any transparency, which alone are in depth and masks.

    Args:
        state: The environments.
        model: The compiled scene.
    """
    rgba = np.asarray(state.model_values("geom_rgba"))
    rgba = rgba.reshape(len(rgba), -1, 4)
    if model.nmat:
        ids = np.asarray(state.model_values("geom_matid")).reshape(-1, model.ngeom)
        materials = np.asarray(state.model_values("mat_rgba")).reshape(-1, model.nmat, 4)
        count = max(len(rgba), len(ids), len(materials))
        rgba = np.broadcast_to(rgba, (count, model.ngeom, 4)).copy()
        ids = np.broadcast_to(ids, (count, model.ngeom))
        materials = np.broadcast_to(materials, (count, model.nmat, 4))
        env, geom = np.nonzero(ids >= 0)
        rgba[env, geom] = _shown_colour(rgba[env, geom], materials[env, ids[env, geom]])
    return rgba[..., 3] >= 1.0


def _shown_colour(colour: NDArray[Any], material: NDArray[Any]) -> NDArray[Any]:
    """(n, 4) a geom's own colour where it is another than MuJoCo's default, else its material's."""
    is_default = np.isclose(colour, _DEFAULT_COLOUR, atol=1e-6).all(axis=1)
    return np.where(is_default[:, None], material, colour)
