"""`blend`: one action from the chunks of actions that were predicted in the last steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["ChunkMemory", "blend"]

F32 = NDArray[np.float32]
ChunkMemory = tuple[F32, F32]
"""(N, H, A) weighted sums of the predictions for this step and the next ones, and (N, H) sums of
their weights."""


def blend(
    chunks: F32, memory: ChunkMemory | None, starts: NDArray[np.bool_] | None, decay: float
) -> tuple[F32, ChunkMemory]:
    """Average the predictions that were made for the current step (temporal ensembling).

    The i-th prediction for the same step, the oldest being the first, has the weight
    exp(-decay * i), as in Zhao et al., "Learning Fine-Grained Bimanual Manipulation with Low-Cost
    Hardware" (2023). Rows are independent of each other.

    Args:
        chunks: (N, H, A) the actions predicted now, for the current step and the H - 1 next ones.
        memory: The memory that the last call returned; None at the first.
        starts: (N,) whether an episode begins, which forgets the predictions before; None: nowhere.
        decay: How much less later predictions count; 0 weighs all alike.

    Returns:
        (N, A) actions, and the memory for the next step; arguments are unchanged.
    """
    if memory is None:
        sums = np.zeros_like(chunks)
        weights = np.zeros(chunks.shape[:2], np.float32)
    else:
        sums = memory[0].copy()
        weights = memory[1].copy()
    if starts is not None:
        sums[starts] = 0.0
        weights[starts] = 0.0
    # After n predictions the weights' sum is (1 - exp(-decay n)) / (1 - exp(-decay)).
    latest = 1.0 - weights * np.float32(-np.expm1(-decay))
    sums += latest[..., None] * chunks
    weights += latest
    actions = sums[:, 0] / weights[:, :1]
    next_sums = np.roll(sums, -1, axis=1)
    next_sums[:, -1] = 0.0
    next_weights = np.roll(weights, -1, axis=1)
    next_weights[:, -1] = 0.0
    return actions, (next_sums, next_weights)
