"""Where everything stands before an episode: one initial row, and which columns are whose."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler import CompiledScene, EntityIndex, ParsedArticulation
    from embodichain.lab.sim.engine.base import F64, Engine

__all__ = ["entity_columns", "initial_row"]


def initial_row(
    engine: Engine, scene: CompiledScene, articulations: Iterable[ParsedArticulation]
) -> F64:
    """Return one row (nstate,): MuJoCo's reset state with every entity at its configured place.

    Drives' targets are the configured joint positions, so nothing moves at the start.
    """
    row: F64 = engine.rows[0].copy()
    qpos, ctrl = row[engine.component("qpos")], row[engine.component("ctrl")]
    mocap_pos = row[engine.component("mocap_pos")]
    mocap_quat = row[engine.component("mocap_quat")]
    for index in scene.entities.values():
        if index.mocap_id >= 0:
            mocap_pos[3 * index.mocap_id :][:3] = index.pos0
            mocap_quat[4 * index.mocap_id :][:4] = index.quat0
        elif index.free_qpos_adr >= 0:
            qpos[index.free_qpos_adr :][:3] = index.pos0
            qpos[index.free_qpos_adr + 3 :][:4] = index.quat0
    for parsed in articulations:
        index = scene.entities[parsed.uid]
        start = np.asarray(parsed.init_qpos, np.float64)
        qpos[np.asarray(index.qpos_adr, np.int64)] = start
        actuators = np.asarray(index.actuator_ids, np.int64)
        # Without stiffness a control is a velocity target.
        target = np.where(np.asarray(parsed.stiffness) > 0, start, 0.0)
        ctrl[actuators[actuators >= 0]] = target[actuators >= 0]
        # Without drives the file's own actuators are kept, at its keyframe's controls.
        own = np.asarray(index.own_actuator_ids, np.int64)
        if len(own):
            ctrl[own] = parsed.init_ctrl
    return row


def entity_columns(engine: Engine, index: EntityIndex) -> NDArray[np.int64]:
    """Return the sorted row columns that belong to one entity."""
    start = {name: engine.component(name).start for name in _COMPONENTS}
    parts: list[Any] = []
    if index.mocap_id >= 0:
        parts += [start["mocap_pos"] + 3 * index.mocap_id + np.arange(3)]
        parts += [start["mocap_quat"] + 4 * index.mocap_id + np.arange(4)]
    dofs = np.asarray(index.dof_adr, np.int64)
    if index.free_qpos_adr >= 0:
        parts += [start["qpos"] + index.free_qpos_adr + np.arange(7)]
        dofs = np.concatenate([index.free_qvel_adr + np.arange(6), dofs])
    parts += [start["qpos"] + np.asarray(index.qpos_adr, np.int64)]
    parts += [start[name] + dofs for name in ("qvel", "qacc_warmstart", "qfrc_applied")]
    actuators = np.asarray(index.actuator_ids, np.int64)
    own = np.asarray(index.own_actuator_ids, np.int64)
    parts += [start["ctrl"] + actuators[actuators >= 0], start["ctrl"] + own]
    bodies = np.asarray(index.body_ids, np.int64)
    parts += [start["xfrc_applied"] + (6 * bodies[:, None] + np.arange(6)).reshape(-1)]
    return np.unique(np.concatenate(parts).astype(np.int64))


_COMPONENTS = (
    "qpos",
    "qvel",
    "qacc_warmstart",
    "qfrc_applied",
    "xfrc_applied",
    "ctrl",
    "mocap_pos",
    "mocap_quat",
)
