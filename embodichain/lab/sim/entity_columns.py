"""`entity_columns`: which columns of a state row belong to one entity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import Engine

__all__ = ["entity_columns"]

_COMPONENTS = (
    *("qpos", "qvel", "act", "qacc_warmstart", "qfrc_applied", "xfrc_applied"),
    *("ctrl", "mocap_pos", "mocap_quat"),
)


def entity_columns(engine: Engine, index: EntityIndex) -> NDArray[np.int64]:
    """Return the sorted row columns that belong to one entity."""
    start = {name: engine.component(name).start for name in _COMPONENTS}
    parts: list[Any] = []
    if index.mocap_id >= 0:
        parts += [start["mocap_pos"] + 3 * index.mocap_id + np.arange(3)]
        parts += [start["mocap_quat"] + 4 * index.mocap_id + np.arange(4)]
    qpos, dofs = _joint_columns(engine.model, index)
    parts += [start["qpos"] + qpos]
    parts += [start[name] + dofs for name in ("qvel", "qacc_warmstart", "qfrc_applied")]
    parts += [start["ctrl"] + np.asarray(index.own_ctrl_ids, np.int64)]
    parts += [start["act"] + np.asarray(index.own_act_ids, np.int64)]
    bodies = np.asarray(index.body_ids, np.int64)
    parts += [start["xfrc_applied"] + (6 * bodies[:, None] + np.arange(6)).reshape(-1)]
    return np.unique(np.concatenate(parts).astype(np.int64))


def _joint_columns(
    model: mujoco.MjModel, index: EntityIndex
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns in qpos and in qvel of every joint of an entity, ball and free joints included."""
    joints = np.flatnonzero(np.isin(model.jnt_bodyid, np.asarray(index.body_ids)))
    dofs = np.flatnonzero(np.isin(model.dof_jntid, joints)).astype(np.int64)
    ends = np.append(model.jnt_qposadr, model.nq)
    qpos = [np.arange(ends[joint], ends[joint + 1]) for joint in joints]
    return np.concatenate([np.zeros(0, np.int64), *qpos]).astype(np.int64), dofs
