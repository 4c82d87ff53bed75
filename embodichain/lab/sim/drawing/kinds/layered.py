"""All environments and cameras at once, with OpenGL 4.5 and layered rendering."""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.sim.drawing.renderer_register import renderer

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.drawing.layered.batch_renderer import BatchRenderer

__all__ = ["open_layered"]


@renderer("layered", outputs=("color", "depth", "mask"), is_tried=True)
def open_layered(model: mujoco.MjModel) -> BatchRenderer:
    """Open a `BatchRenderer`."""
    from embodichain.lab.sim.drawing.layered.batch_renderer import BatchRenderer

    return BatchRenderer(model)
