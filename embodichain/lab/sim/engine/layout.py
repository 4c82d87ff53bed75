"""Which columns of an integration-state row hold which component of the state."""

from __future__ import annotations

import mujoco

__all__ = ["row_layout"]

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
