"""Poses and distances of resolved entities, shared by terms of several kinds.

Positions are the engine's own float64 numbers, turned into a tensor once, at the end: a dozen small
tensor operations would cost more than the physics of one environment. Sums run over columns in a
fixed order, because a reduction may round differently for another number of environments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.base import F64
else:
    torch = lazy_loader.load("torch")

__all__ = ["distance", "norm", "pose", "position", "tensor"]


def pose(entity: ResolvedEntity) -> torch.Tensor:
    """(N, 7) float32 x, y, z, qw, qx, qy, qz of the picked link, else of the root."""
    link = entity.link_name
    found: torch.Tensor = (
        entity.asset.get_local_pose() if link is None else entity.asset.get_link_pose(link)
    )
    return found


def position(entity: ResolvedEntity) -> F64:
    """(N, 3) metres in the environment's frame: a live view, not to be written to or kept."""
    body = entity.link_body
    found: F64 = (
        entity.asset.read_pose()[0]
        if body is None
        else entity.asset.engine.derived("xpos")[:, body]
    )
    return found


def norm(vectors: F64) -> F64:
    """Euclidean length of the rows, (N, K) -> (N,), summed from the first column on."""
    squares = vectors * vectors
    total = squares[:, 0]
    for column in range(1, squares.shape[1]):
        total = total + squares[:, column]
    found: F64 = np.sqrt(total)
    return found


def distance(a: ResolvedEntity, b: ResolvedEntity, use_xy_only: bool = False) -> F64:
    """(N,) metres between two entities, in the plane only if asked."""
    delta = position(b) - position(a)
    return norm(delta[:, :2] if use_xy_only else delta)


def tensor(array: NDArray[np.float64] | NDArray[np.bool_]) -> torch.Tensor:
    """A tensor of its own: float32, or bool."""
    return torch.from_numpy(array if array.dtype == np.bool_ else array.astype(np.float32))
