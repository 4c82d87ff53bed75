"""From declared configs to one MuJoCo model: `parse_articulation` and `compile_scene`.

Nothing here steps physics, and nothing here imports torch.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.articulation import ParsedArticulation, parse_articulation
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.scene import CompiledScene, compile_scene

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "articulation": ["ParsedArticulation", "parse_articulation"],
        "index": ["EntityIndex"],
        "scene": ["CompiledScene", "compile_scene"],
    },
)

__all__ = [
    "CompiledScene",
    "EntityIndex",
    "ParsedArticulation",
    "compile_scene",
    "parse_articulation",
]
