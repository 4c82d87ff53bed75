"""`EntityIndex`: indices of one entity in the compiled model; `VariantIndex`. Data only."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["F64", "EntityIndex", "Ids", "Mask", "VariantIndex"]

F64 = NDArray[np.float64]
Ids = NDArray[np.int64]
Mask = NDArray[np.bool_]
_NONE: Ids = np.zeros(0, np.int64)


@dataclass(frozen=True, eq=False)
class VariantIndex:
    """Values of model fields with each of the K shapes of an object with G geoms.

    Attributes:
        names: (K,) names of the shapes.
        contype: (K, G) `geom_contype`; 0 of the geoms of other shapes.
        conaffinity: (K, G) likewise.
        alpha: (K, G) opacity in `geom_rgba`; 0 of the geoms of other shapes.
        materials: (K, G) `geom_matid`; -1 of the geoms of other shapes.
        mass: (K,) kg.
        ipos: (K, 3) centre of mass in the body's frame, m.
        iquat: (K, 4) principal axes, wxyz.
        inertia: (K, 3) principal moments, kg m^2.
    """

    names: tuple[str, ...]
    contype: Ids
    conaffinity: Ids
    alpha: F64
    materials: Ids
    mass: F64
    ipos: F64
    iquat: F64
    inertia: F64


@dataclass(frozen=True, eq=False)
class EntityIndex:
    """Indices of one entity in the compiled model.

    Attributes:
        uid: The entity's uid.
        kind: Its kind.
        body_ids: (L,) its bodies; for an articulation in the order of `link_names`.
        root_body_id: The body with the entity's pose.
        pos0: (3,) initial root position in metres.
        quat0: (4,) initial root orientation, wxyz.
        geom_ids: (G,) its geoms, visual ones included.
        mocap_id: Its row of mocap_pos, or -1.
        free_qpos_adr: First of its free joint's 7 columns in qpos, or -1.
        free_qvel_adr: First of its free joint's 6 columns in qvel, or -1.
        qpos_adr: (D,) columns of its joints in qpos, in the order of `joint_names`.
        dof_adr: (D,) columns of its joints in qvel.
        actuator_ids: (D,) the actuator that takes each joint's targets, or -1.
        ctrl_ids: (D,) column in ctrl of that actuator, or -1.
        velocity_ctrl_ids: (D,) column in ctrl of an additional velocity servo, or -1.
        own_actuator_ids: All its actuators, in the model's order.
        own_ctrl_ids: (M,) columns in ctrl of all its controls, in the model's order.
        own_act_ids: (K,) columns in act of all its activations.
        variants: The shapes of an object with `any_of`, else None.
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
    variants: VariantIndex | None = None
