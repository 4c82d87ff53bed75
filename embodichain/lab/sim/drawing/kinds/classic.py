"""Picture after picture with MuJoCo's own renderer, with any OpenGL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.sim.drawing.renderer_register import renderer

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.drawing.classic import ClassicRenderer

__all__ = ["open_classic"]


@renderer("classic", outputs=("color", "depth", "mask"), is_tried=True)
def open_classic(model: mujoco.MjModel) -> ClassicRenderer:
    """Open a `ClassicRenderer`."""
    from embodichain.lab.sim.drawing.classic import ClassicRenderer

    return ClassicRenderer(model)
