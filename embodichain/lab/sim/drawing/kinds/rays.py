"""Depth and masks with MuJoCo's rays, without OpenGL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.sim.drawing.renderer_register import renderer

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.drawing.rays import RayRenderer

__all__ = ["open_rays"]


@renderer("rays", outputs=("depth", "mask"), is_tried=True)
def open_rays(model: mujoco.MjModel) -> RayRenderer:
    """Open a `RayRenderer`."""
    from embodichain.lab.sim.drawing.rays import RayRenderer

    return RayRenderer(model)
