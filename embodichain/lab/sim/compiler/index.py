"""`EntityIndex`: where the compiled model keeps one entity. Data only."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["F64", "EntityIndex", "Ids", "Mask"]

F64 = NDArray[np.float64]
Ids = NDArray[np.int64]
Mask = NDArray[np.bool_]
_NONE: Ids = np.zeros(0, np.int64)


@dataclass(frozen=True, eq=False)
class EntityIndex:
    """Indices of one entity in the compiled model.

    Attributes:
        uid: The entity.
        kind: What it is.
        body_ids: (L,) its bodies; of an articulation in the order of `link_names`.
        root_body_id: The body whose pose is the entity's.
        pos0: (3,) initial root position in metres.
        quat0: (4,) initial root orientation, wxyz.
        geom_ids: (G,) its geoms, visual ones included.
        mocap_id: Its row of mocap_pos, or -1.
        free_qpos_adr: Where its root's 7 coordinates start in qpos, or -1.
        free_qvel_adr: Where its root's 6 velocities start in qvel, or -1.
        qpos_adr: (D,) columns of its joints in qpos, in the order of `joint_names`.
        dof_adr: (D,) columns of its joints in qvel.
        actuator_ids: (D,) the actuator that takes each joint's targets, or -1.
        ctrl_ids: (D,) its column in ctrl, or -1.
        velocity_ctrl_ids: (D,) column in ctrl of a velocity servo beside it, or -1.
        own_actuator_ids: All its actuators, in the model's order.
        own_ctrl_ids: (M,) all its controls: their columns in ctrl, in the model's order.
        own_act_ids: (K,) all its activations: their columns in act.
    """

    uid: str
    kind: Literal["articulation", "object"]
    body_ids: Ids
    root_body_id: int
    pos0: F64
    quat0: F64
    geom_ids: Ids
    mocap_id: int = -1
    free_qpos_adr: int = -1
    free_qvel_adr: int = -1
    qpos_adr: Ids = field(default_factory=_NONE.copy)
    dof_adr: Ids = field(default_factory=_NONE.copy)
    actuator_ids: Ids = field(default_factory=_NONE.copy)
    ctrl_ids: Ids = field(default_factory=_NONE.copy)
    velocity_ctrl_ids: Ids = field(default_factory=_NONE.copy)
    own_actuator_ids: Ids = field(default_factory=_NONE.copy)
    own_ctrl_ids: Ids = field(default_factory=_NONE.copy)
    own_act_ids: Ids = field(default_factory=_NONE.copy)
