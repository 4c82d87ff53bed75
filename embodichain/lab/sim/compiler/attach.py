"""`attach`: hang one model on a link of another. Names of the child get a prefix."""

from __future__ import annotations

import mujoco

from embodichain.lab.sim.compiler.index import F64

__all__ = ["attach"]


def attach(
    parent: mujoco.MjSpec,
    child: mujoco.MjSpec,
    link: str,
    pos: F64,
    quat: F64,
    prefix: str,
) -> None:
    """Fix a model's world on a link.

    Args:
        parent: Grows by the child's bodies, joints, shapes, assets, equalities and actuators.
        child: A copy of it is used; it stays as it is.
        link: A body of the parent.
        pos: (3,) metres, the child's world in the link's frame.
        quat: (4,) wxyz, likewise.
        prefix: Before every name of the child; no name of the parent may begin with it.

    Raises:
        ValueError: If the parent has no such link.
    """
    body = parent.body(link)
    if body is None:
        raise ValueError(f"no link is called {link!r}")
    parent.attach(child.copy(), frame=body.add_frame(pos=pos, quat=quat), prefix=prefix)
