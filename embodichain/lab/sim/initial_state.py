"""Where everything stands before an episode: one initial row, and which columns are whose."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.rigid_math import initial_pose
from embodichain.utils.math import quat_rotate

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.articulation import ParsedArticulation
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.scene import CompiledScene
    from embodichain.lab.sim.engine.base import F64, Engine

__all__ = ["entity_columns", "initial_row"]


def initial_row(
    engine: Engine, scene: CompiledScene, articulations: Iterable[ParsedArticulation]
) -> F64:
    """Return one row (nstate,): MuJoCo's reset state with every entity at its configured place.

    Drives' targets are the configured joint positions, so nothing moves at the start; what else a
    file's keyframe says (velocities, controls, activations, ball joints) is taken over.
    """
    row: F64 = engine.rows[0].copy()
    qpos, qvel = row[engine.component("qpos")], row[engine.component("qvel")]
    ctrl, act = row[engine.component("ctrl")], row[engine.component("act")]
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
        qvel[np.asarray(index.dof_adr, np.int64)] = parsed.init_qvel
        ctrl[np.asarray(index.own_ctrl_ids, np.int64)] = parsed.init_ctrl
        act[np.asarray(index.own_act_ids, np.int64)] = parsed.init_act
        if parsed.keyframe is None:
            continue
        if index.free_qvel_adr >= 0:
            _, turn = initial_pose(parsed.cfg)
            velocity = parsed.keyframe.root_qvel
            qvel[index.free_qvel_adr :][:3] = quat_rotate(turn, velocity[:3])
            qvel[index.free_qvel_adr + 3 :][:3] = velocity[3:]
        for name, (quat, speed) in parsed.keyframe.balls.items():
            joint = scene.model.joint(f"{parsed.uid}/{name}")
            qpos[int(joint.qposadr[0]) :][:4] = quat
            qvel[int(joint.dofadr[0]) :][:3] = speed
    return row


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


_COMPONENTS = (
    "qpos",
    "qvel",
    "act",
    "qacc_warmstart",
    "qfrc_applied",
    "xfrc_applied",
    "ctrl",
    "mocap_pos",
    "mocap_quat",
)
