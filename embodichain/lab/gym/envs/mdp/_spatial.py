"""Poses and distances of resolved entities, shared by terms of several kinds.

Sums run over columns in a fixed order: a reduction by torch may round differently for another
number of environments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity

if TYPE_CHECKING:
    import torch

__all__ = ["distance", "norm", "pose", "position"]


def pose(entity: ResolvedEntity) -> torch.Tensor:
    """(N, 7) float32 x, y, z, qw, qx, qy, qz of the picked link, else of the root."""
    link = entity.link_name
    found: torch.Tensor = (
        entity.asset.get_local_pose() if link is None else entity.asset.get_link_pose(link)
    )
    return found


def position(entity: ResolvedEntity) -> torch.Tensor:
    """(N, 3) float32 metres in the environment's frame."""
    return pose(entity)[:, :3]


def norm(vectors: torch.Tensor) -> torch.Tensor:
    """Euclidean length of the rows, (N, K) -> (N,), summed from the first column on."""
    first, *others = vectors.unbind(1)
    total = first * first
    for column in others:
        total = total + column * column
    return total.sqrt()


def distance(a: ResolvedEntity, b: ResolvedEntity, use_xy_only: bool = False) -> torch.Tensor:
    """(N,) metres between two entities, in the plane only if asked."""
    delta = position(b) - position(a)
    return norm(delta[:, :2] if use_xy_only else delta)
