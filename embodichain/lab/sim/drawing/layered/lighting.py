"""Lights of environments as numbers for shaders, and what lights that cast shadows see."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.views import DrawnState

__all__ = ["casters", "light_table", "positional", "shadow_views"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_DIRECTIONAL = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
_SPOT = int(mujoco.mjtLightType.mjLIGHT_SPOT)
_MOST_CASTERS = 4
_WIDEST_SPOT = 160.0
"""Degrees of a spot light that its shadow map covers."""
_EMPTY = 1e6
"""Bound of what no geom bounds: larger than any scene, in metres."""


def light_table(state: DrawnState, rows: NDArray[np.int64], look_rows: NDArray[np.int64]) -> F32:
    """(n, 1 + 5 L, 4) lights of environments.

    Args:
        state: The environments.
        rows: (n,) which.
        look_rows: (n,) their rows of `SurfaceTable.table`.

    Returns:
        First ambient light and the row of looks. Then of each light: direction and 1 if it has a
        position; diffuse; specular; position and cosine of the cutoff, -1 without; attenuation
        (constant, linear, quadratic) and exponent.
    """
    model = state.model
    count = len(rows)
    table = np.zeros((count, 1 + 5 * model.nlight, 4), np.float32)
    headlight = model.vis.headlight
    table[:, 0, :3] = headlight.ambient if headlight.active else 0.0
    table[:, 0, 3] = look_rows
    if not model.nlight:
        return table
    lights = table[:, 1:].reshape(count, model.nlight, 5, 4)

    def numbers(name: str) -> NDArray[Any]:
        values = _of_rows(state.model_values(name), rows)
        return values.reshape(len(values), model.nlight)

    def vectors(name: str) -> NDArray[Any]:
        values = _of_rows(state.model_values(name), rows)
        return values.reshape(len(values), model.nlight, 3)

    is_active = (numbers("light_active") != 0)[..., None]
    table[:, 0, :3] += (is_active * vectors("light_ambient")).sum(axis=1)
    kind = numbers("light_type")
    lights[..., 0, :3] = _unit(state.derived("light_xdir")[rows])
    lights[..., 0, 3] = kind != _DIRECTIONAL
    lights[..., 1, :3] = is_active * vectors("light_diffuse")
    lights[..., 2, :3] = is_active * vectors("light_specular")
    lights[..., 3, :3] = state.derived("light_xpos")[rows]
    cutoff = np.cos(np.radians(numbers("light_cutoff")))
    lights[..., 3, 3] = np.where(kind == _SPOT, cutoff, -1.0)
    lights[..., 4, :3] = vectors("light_attenuation")
    lights[..., 4, 3] = numbers("light_exponent")
    return table


def positional(state: DrawnState) -> bool:
    """Whether any light has a position."""
    return bool((state.model_values("light_type") != _DIRECTIONAL).any())


def casters(state: DrawnState) -> tuple[int, ...]:
    """Lights that cast shadows in any environment: directional ones and spots, the first four."""
    count = state.model.nlight
    if not count:
        return ()
    kind = state.model_values("light_type").reshape(-1, count)
    # A point light would need six maps, one for each side of a cube.
    has_map = ((kind == _DIRECTIONAL) | (kind == _SPOT)).any(axis=0)
    casts_shadow = (state.model_values("light_castshadow").reshape(-1, count) != 0).any(axis=0)
    is_active = (state.model_values("light_active").reshape(-1, count) != 0).any(axis=0)
    lights = np.flatnonzero(has_map & casts_shadow & is_active)
    return tuple(int(light) for light in lights[:_MOST_CASTERS])


def shadow_views(
    state: DrawnState, rows: NDArray[np.int64], lights: tuple[int, ...], geoms: NDArray[np.int64]
) -> F32:
    """(n, len(lights), 4, 4) projections of what lights see, as tight as bounding spheres allow.

    Args:
        state: The environments.
        rows: (n,) which.
        lights: Lights that cast shadows, see `casters`.
        geoms: (G,) geoms that cast them.
    """
    centres = state.derived("geom_xpos")[rows][:, geoms]
    radii = _of_rows(state.model_values("geom_rbound"), rows)[:, geoms]
    radii = np.broadcast_to(radii, centres.shape[:2])
    kinds = state.model_values("light_type").reshape(-1, state.model.nlight)
    cutoffs = state.model_values("light_cutoff").reshape(-1, state.model.nlight)
    views = np.zeros((len(rows), len(lights), 4, 4), np.float32)
    for slot, light in enumerate(lights):
        axes = _axes(state.derived("light_xdir")[rows][:, light])
        if kinds[0, light] == _DIRECTIONAL:
            views[:, slot] = _directional_view(axes, centres, radii)
        else:
            eye = state.derived("light_xpos")[rows][:, light]
            cutoff = float(cutoffs[:, light].max())
            views[:, slot] = _spot_view(axes, eye, centres, radii, cutoff=cutoff)
    views[:, :, 2] = 0.5 * (views[:, :, 2] + views[:, :, 3])  # depths from 0 to 1
    return views


def _of_rows(values: NDArray[Any], rows: NDArray[np.int64]) -> NDArray[Any]:
    """Return the values of some environments; a single row is that of all."""
    if len(values) == 1:
        return values
    return values[rows]


def _unit(vectors: F64) -> F64:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _axes(direction: F64) -> F64:
    """(n, 3, 3) rows: right, up and backwards of an eye that looks along a direction."""
    back = -_unit(direction)
    upwards = np.where(np.abs(back[:, 2:]) > 0.9, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    right = _unit(np.cross(upwards, back))
    return np.stack([right, np.cross(back, right), back], axis=1)


def _in_eye(axes: F64, points: F64) -> F64:
    """(n, G, 3) points in the axes of an eye; sums in a fixed order, whatever n is."""
    return (points[:, :, None] * axes[:, None]).sum(axis=-1)


def _directional_view(axes: F64, centres: F64, radii: F64) -> F64:
    """(n, 4, 4) of light from infinitely far: the box around all bounding spheres."""
    centres = _in_eye(axes, centres)
    low = (centres - radii[..., None]).min(axis=1, initial=_EMPTY)
    high = (centres + radii[..., None]).max(axis=1, initial=-_EMPTY)
    high = np.maximum(high, low + 1e-3)
    middle = (high + low) / 2.0
    scale = 2.0 / (high - low)
    scale[:, 2] *= -1.0  # an eye looks along -z, and depth grows away from it
    view = np.zeros((len(axes), 4, 4))
    view[:, :3, :3] = scale[:, :, None] * axes
    view[:, :3, 3] = -scale * middle
    view[:, 3, 3] = 1.0
    return view


def _spot_view(axes: F64, eye: F64, centres: F64, radii: F64, *, cutoff: float) -> F64:
    """(n, 4, 4) of a spot light; `cutoff` is half its angle, in degrees."""
    focal = 1.0 / np.tan(np.radians(min(2.0 * cutoff, _WIDEST_SPOT)) / 2.0)
    z = _in_eye(axes, centres - eye[:, None])[..., 2]
    far = np.maximum((radii - z).max(axis=1, initial=0.0), 0.2)
    nearest = (-radii - z).min(axis=1, initial=_EMPTY)
    # A map's depths are coarse where near is far below far.
    near = np.clip(nearest, far / 50.0, 0.9 * far)

    projection = np.zeros((len(axes), 4, 4))
    projection[:, 0, 0] = focal
    projection[:, 1, 1] = focal
    projection[:, 2, 2] = -(far + near) / (far - near)
    projection[:, 2, 3] = -2.0 * far * near / (far - near)
    projection[:, 3, 2] = -1.0

    world_to_eye = np.zeros((len(axes), 4, 4))
    world_to_eye[:, :3, :3] = axes
    world_to_eye[:, :3, 3] = -(axes * eye[:, None]).sum(axis=-1)
    world_to_eye[:, 3, 3] = 1.0
    return (projection[:, :, :, None] * world_to_eye[:, None]).sum(axis=2)
