"""Columns of an integration-state row, and indices into rows of environments."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["as_slice", "entries", "row_layout"]

_COMPONENTS = {
    "time": "TIME",
    "qpos": "QPOS",
    "qvel": "QVEL",
    "act": "ACT",
    "history": "HISTORY",
    "qacc_warmstart": "WARMSTART",
    "ctrl": "CTRL",
    "qfrc_applied": "QFRC_APPLIED",
    "xfrc_applied": "XFRC_APPLIED",
    "eq_active": "EQ_ACTIVE",
    "mocap_pos": "MOCAP_POS",
    "mocap_quat": "MOCAP_QUAT",
    "userdata": "USERDATA",
    "plugin_state": "PLUGIN",
    "plastic": "PLASTIC",
}


def row_layout(model: mujoco.MjModel) -> dict[str, slice]:
    """Return the columns of every state component within an integration-state row.

    The order of components is MuJoCo's: ascending bits of `mjtState` within `mjSTATE_INTEGRATION`.
    """
    bits = {
        name: int(getattr(mujoco.mjtState, f"mjSTATE_{suffix}"))
        for name, suffix in _COMPONENTS.items()
        if hasattr(mujoco.mjtState, f"mjSTATE_{suffix}")
    }
    whole = int(mujoco.mjtState.mjSTATE_INTEGRATION)
    known = {bit: name for name, bit in bits.items() if bit & whole}
    layout: dict[str, slice] = {}
    start = 0
    for position in range(32):
        bit = 1 << position
        if not whole & bit:
            continue
        size = mujoco.mj_stateSize(model, bit)
        layout[known.get(bit, f"state_{position}")] = slice(start, start + size)
        start += size
    return layout


def as_slice(indices: NDArray[np.int64]) -> Any:
    """Ascending indices, as a slice where they are neighbours: views instead of copies."""
    if len(indices) and (np.diff(indices) == 1).all():
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices


def entries(
    env_ids: NDArray[np.int64] | None, columns: NDArray[np.int64] | slice
) -> tuple[Any, Any]:
    """Return the index of columns in the rows of environments; None is all environments."""
    if env_ids is None:
        return slice(None), columns
    return (env_ids if isinstance(columns, slice) else env_ids[:, None]), columns
