"""`joint_action` under the names of EmbodiChain and Isaac Lab, one a control and centre."""

from __future__ import annotations

from functools import partial
from typing import Literal

from embodichain.compat.terms._alias import alias
from embodichain.lab.gym.envs.mdp.actions.joint_action import JointAction

_JOINTS = {"entity_cfg": "entity_cfg"}
_AFFINE = ("scale", "offset", "clip")
_action = partial(alias, "action", target=JointAction, params=_JOINTS, caller=__name__)

_action(
    "joint_position",
    summary="Absolute joint position targets: EmbodiChain's QposTerm, Isaac Lab's "
    "JointPositionAction with ``use_default_offset: false``.",
    options=_AFFINE,
    example="{func: joint_position, params: {entity_cfg: {uid: ur10}}}",
)
_action(
    "default_offset_joint_position",
    summary="Joint position targets around the initial position, for learners: Isaac Lab's "
    "JointPositionAction with ``use_default_offset: true``.",
    options=_AFFINE,
    defaults={"clip": (-1.0, 1.0)},
    fixed={"centre": "home"},
    example="{func: default_offset_joint_position, params: {entity_cfg: {uid: ur10}, scale: 0.6}}",
)
_action(
    "relative_joint_position",
    summary="Joint position targets relative to the joints' positions: EmbodiChain's "
    "DeltaQposTerm, Isaac Lab's RelativeJointPositionAction, applied once a control step.",
    params={**_JOINTS, "reference": "centre"},
    options=_AFFINE,
    defaults={"reference": "qpos", "clip": (-1.0, 1.0)},
    hints={"reference": Literal["qpos", "target"]},
    example="{func: relative_joint_position, params: {entity_cfg: {uid: ur10}, scale: 0.05}}",
)
_action(
    "joint_position_to_limits",
    summary="Joint position targets over the joints' whole range: EmbodiChain's "
    "QposDenormalizedTerm, Isaac Lab's JointPositionToLimitsAction.",
    options=(*_AFFINE, "range"),
    fixed={"centre": "limits"},
    example="{func: joint_position_to_limits, params: {entity_cfg: {uid: ur10}, range: [-1, 1]}}",
)
_action(
    "joint_velocity",
    summary="Joint velocity targets: EmbodiChain's QvelTerm, Isaac Lab's JointVelocityAction.",
    options=_AFFINE,
    defaults={"clip": (-1.0, 1.0)},
    fixed={"control": "velocity"},
    example="{func: joint_velocity, params: {entity_cfg: {uid: ur10}, scale: {'Joint.*': 0.5}}}",
)
_action(
    "joint_effort",
    summary="Joint efforts: EmbodiChain's QfTerm, Isaac Lab's JointEffortAction.",
    options=_AFFINE,
    defaults={"clip": (-1.0, 1.0)},
    fixed={"control": "effort"},
    example="{func: joint_effort, params: {entity_cfg: {uid: ur10}, scale: 10.0, clip: [-1, 1]}}",
)
