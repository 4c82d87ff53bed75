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
    model, count = state.model, len(rows)
    table = np.zeros((count, 1 + 5 * model.nlight, 4), np.float32)
    headlight = model.vis.headlight
    table[:, 0, :3] = headlight.ambient if headlight.active else 0.0
    table[:, 0, 3] = look_rows
    if not model.nlight:
        return table
    lights = table[:, 1:].reshape(count, model.nlight, 5, 4)

    def field(name: str, width: int = 0) -> NDArray[Any]:
        values = state.model_values(name)
        found = values if len(values) == 1 else values[rows]
        return found.reshape(len(found), model.nlight, *([width] if width else []))

    active = (field("light_active") != 0)[..., None]
    table[:, 0, :3] += (active * field("light_ambient", 3)).sum(axis=1)
    kind = field("light_type")
    lights[..., 0, :3] = _unit(state.derived("light_xdir")[rows])
    lights[..., 0, 3] = kind != _DIRECTIONAL
    lights[..., 1, :3] = active * field("light_diffuse", 3)
    lights[..., 2, :3] = active * field("light_specular", 3)
    lights[..., 3, :3] = state.derived("light_xpos")[rows]
    cutoff = np.cos(np.radians(field("light_cutoff")))
    lights[..., 3, 3] = np.where(kind == _SPOT, cutoff, -1.0)
    lights[..., 4, :3] = field("light_attenuation", 3)
    lights[..., 4, 3] = field("light_exponent")
    return table


def positional(state: DrawnState) -> bool:
    """Whether any light has a position."""
    return bool((state.model_values("light_type") != _DIRECTIONAL).any())


def casters(state: DrawnState) -> tuple[int, ...]:
    """Lights that cast shadows in any environment: directional ones and spots, the first four."""
    if not state.model.nlight:
        return ()
    kind = state.model_values("light_type").reshape(-1, state.model.nlight)
    casts = state.model_values("light_castshadow").reshape(-1, state.model.nlight) != 0
    active = state.model_values("light_active").reshape(-1, state.model.nlight) != 0
    shaped = ((kind == _DIRECTIONAL) | (kind == _SPOT)).any(axis=0)
    found = np.flatnonzero(shaped & casts.any(axis=0) & active.any(axis=0))
    return tuple(int(light) for light in found[:_MOST_CASTERS])


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
    places = state.derived("geom_xpos")[rows][:, geoms]
    bounds = state.model_values("geom_rbound")
    reach = np.broadcast_to(
        (bounds if len(bounds) == 1 else bounds[rows])[:, geoms], places.shape[:2]
    )
    kinds = state.model_values("light_type").reshape(-1, state.model.nlight)
    cutoffs = state.model_values("light_cutoff").reshape(-1, state.model.nlight)
    found = np.zeros((len(rows), len(lights), 4, 4), np.float32)
    for slot, light in enumerate(lights):
        axes = _axes(state.derived("light_xdir")[rows][:, light])
        if kinds[0, light] == _DIRECTIONAL:
            found[:, slot] = _parallel(axes, places, reach)
        else:
            eye = state.derived("light_xpos")[rows][:, light]
            found[:, slot] = _spread(axes, eye, places, reach, float(cutoffs[:, light].max()))
    found[:, :, 2] = 0.5 * (found[:, :, 2] + found[:, :, 3])  # depths from 0 to 1
    return found


def _unit(vectors: F64) -> F64:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _axes(direction: F64) -> F64:
    """(n, 3, 3) rows: right, up and backwards of an eye that looks along a direction."""
    back = -_unit(direction)
    upwards = np.where(np.abs(back[:, 2:]) > 0.9, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    right = _unit(np.cross(upwards, back))
    return np.stack([right, np.cross(back, right), back], axis=1)


def _along(axes: F64, places: F64) -> F64:
    """(n, G, 3) places in the frame of an eye; sums in a fixed order, whatever n is."""
    return (places[:, :, None] * axes[:, None]).sum(axis=-1)


def _parallel(axes: F64, places: F64, reach: F64) -> F64:
    """(n, 4, 4) of light from infinitely far: the box around all bounding spheres."""
    seen = _along(axes, places)
    low = (seen - reach[..., None]).min(axis=1, initial=1e6)
    high = np.maximum((seen + reach[..., None]).max(axis=1, initial=-1e6), low + 1e-3)
    scale, middle = 2.0 / (high - low), (high + low) / 2.0
    scale[:, 2] *= -1.0
    found = np.zeros((len(axes), 4, 4))
    found[:, :3, :3] = scale[:, :, None] * axes
    found[:, :3, 3] = -scale * middle
    found[:, 3, 3] = 1.0
    return found


def _spread(axes: F64, eye: F64, places: F64, reach: F64, cutoff: float) -> F64:
    """(n, 4, 4) of a spot light."""
    focal = 1.0 / np.tan(np.radians(min(2.0 * cutoff, _WIDEST_SPOT)) / 2.0)
    seen = _along(axes, places - eye[:, None])
    far = np.maximum((reach - seen[..., 2]).max(axis=1, initial=0.0), 0.2)
    near = np.clip((-reach - seen[..., 2]).min(axis=1, initial=1e6), far / 50.0, 0.9 * far)
    found = np.zeros((len(axes), 4, 4))
    rows = np.zeros((len(axes), 4, 4))
    rows[:, 0, 0] = rows[:, 1, 1] = focal
    rows[:, 2, 2], rows[:, 2, 3] = -(far + near) / (far - near), -2.0 * far * near / (far - near)
    rows[:, 3, 2] = -1.0
    found[:, :3, :3] = axes
    found[:, :3, 3] = -(axes * eye[:, None]).sum(axis=-1)
    found[:, 3, 3] = 1.0
    return (rows[:, :, :, None] * found[:, None]).sum(axis=2)
