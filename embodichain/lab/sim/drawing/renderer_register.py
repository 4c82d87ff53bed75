"""The register of renderers: `RENDERERS`, `renderer`.

A renderer is a function that opens one for a scene, registered where it is defined; what it returns
is a `views.Renderer`. The function may import OpenGL, the module should not::

    @renderer("flat", outputs=("color", "depth", "mask"))
    def open_flat(model: mujoco.MjModel) -> Flat:
        return Flat()

A package outside names its module with an entry point of the group ``embodichain.renderers``,
called as the renderer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

from embodichain.utils.register import Register

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.drawing.views import Output, Renderer

__all__ = ["RENDERERS", "OpenRenderer", "RendererKind", "renderer"]

_KINDS = "embodichain.lab.sim.drawing.kinds"


class OpenRenderer(Protocol):
    """Opens a renderer for a scene; called in the render thread, as all that it draws is."""

    def __call__(self, model: mujoco.MjModel) -> Renderer:
        """Return it.

        Raises:
            RenderError: If it does not work here; says what would help.
        """


@dataclass(frozen=True)
class RendererKind:
    """A renderer, as EMBODICHAIN_RENDERER names it.

    Attributes:
        open: Opens it for a scene.
        outputs: What it can draw, of ``color``, ``depth`` and ``mask``.
        is_tried: Whether it is tried where EMBODICHAIN_RENDERER names none, after those before it
            in the register. Else it draws only where it is named.
        requires: What pip installs for the packages that it needs.
    """

    open: OpenRenderer
    outputs: tuple[Output, ...]
    is_tried: bool = False
    requires: str = ""


Open = TypeVar("Open", bound=OpenRenderer)

RENDERERS: Register[RendererKind] = Register(
    "renderer",
    group="embodichain.renderers",
    modules=(f"{_KINDS}.layered", f"{_KINDS}.classic", f"{_KINDS}.rays"),  # the best first
)
"""Name -> the renderer; modules and entry points are called as the renderers."""


def renderer(
    name: str, *, outputs: Sequence[Output], is_tried: bool = False, requires: str = ""
) -> Callable[[Open], Open]:
    """Register a function ``open(model)`` as a renderer; arguments as of `RendererKind`.

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If another function has the name, or there are no outputs.
    """
    if not outputs:
        raise ValueError(f"the renderer {name!r} draws nothing: outputs are color, depth, mask")

    def decorate(function: Open) -> Open:
        kind = RendererKind(
            open=function,
            outputs=tuple(outputs),
            is_tried=is_tried,
            requires=requires,
        )
        RENDERERS.add(name, describes=function)(kind)
        return function

    return decorate
