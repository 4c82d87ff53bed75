"""Observations of what things are, not where: sizes, masses, friction, drives.

For critics that see what randomization did. Everything is read anew each time, so it is never
older than the last randomization.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import lazy_loader
import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.lab.gym.envs.mdp._joints import Joints
from embodichain.lab.gym.envs.mdp.observations._computed import Computed
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64
else:
    torch = lazy_loader.load("torch")

__all__ = [
    "GetArticulationJointDrive",
    "GetRigidObjectPhysicsAttributes",
    "get_object_body_scale",
    "get_object_uid",
]

Attribute = Literal["mass", "friction", "damping", "inertia"]
Gain = Literal["stiffness", "damping", "max_effort", "max_velocity", "friction", "armature"]
Attributes = Annotated[Sequence[Attribute], Field(min_length=1)]
Gains = Annotated[Sequence[Gain], Field(min_length=1)]
_ALL_GAINS: tuple[Gain, ...] = get_args(Gain)
_NO_LIMIT = 1e10
"""What EmbodiChain's configs write for an effort or velocity without a limit."""


@register_term("observation")
def get_object_body_scale(env: TermContext, obs: Any, entity_cfg: ResolvedEntity) -> torch.Tensor:
    """(N, 3) scale of an entity's declared shape or file, along its own axes.

    EmbodiChain's observation of the same name.

    Example:
        ``{func: get_object_body_scale, params: {entity_cfg: {uid: cube}}}``

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The object or robot.
    """
    asset = entity_cfg.asset
    if hasattr(asset, "get_body_scale"):
        scale: torch.Tensor = asset.get_body_scale()
        return scale
    return _spatial.tensor(np.tile(np.asarray(asset.cfg.body_scale, np.float64), (env.num_envs, 1)))


@register_term("observation")
def get_object_uid(env: TermContext, obs: Any, entity_cfg: ResolvedEntity) -> torch.Tensor:
    """(N,) int32 number of an entity in segmentation images: MuJoCo's id of its (root) body.

    EmbodiChain's observation of the same name.

    Example:
        ``{func: get_object_uid, params: {entity_cfg: {uid: cube}}}``

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The entity, or one link of it.
    """
    return torch.full((env.num_envs,), _body.body_id(entity_cfg), dtype=torch.int32)


@register_term("observation", name="get_rigid_object_physics_attributes")
class GetRigidObjectPhysicsAttributes(Term):
    """Physical properties of a rigid object side by side, each environment's own.

    ``mass`` (kg), ``friction`` (sliding), ``damping`` (linear, angular, 1/s) and ``inertia`` (three
    principal moments, kg m^2): (N, 7) with all of them. EmbodiChain's observation of the same name
    gives a nested dictionary; here it is one vector, that a learner can take.

    Example:
        ``{func: get_rigid_object_physics_attributes, params: {entity_cfg: {uid: cube}}}``

    Args:
        entity_cfg: The object.
        attributes: Which, in the order wanted.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        attributes: Attributes = ("mass", "friction", "damping", "inertia"),
    ) -> None:
        asset = entity_cfg.asset
        if not hasattr(asset, "get_friction"):
            message = f"{entity_cfg.uid!r} is no rigid object; see get_articulation_joint_drive"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        self._reads = [getattr(asset, f"get_{name}") for name in attributes]

    def __call__(self, env: TermContext, obs: Any) -> torch.Tensor:
        """(N, K) the attributes side by side."""
        return torch.cat([read().reshape(env.num_envs, -1) for read in self._reads], dim=1)


@register_term("observation", name="get_articulation_joint_drive")
class GetArticulationJointDrive(Computed):
    """Properties of joints and their drives side by side, each environment's own.

    K columns of the picked joints for each property: stiffness (N m/rad), damping (N m s/rad),
    max_effort (N m), max_velocity (rad/s), friction (N m), armature (kg m^2); N, m and kg for
    slides. What has no limit reads 1e10, as EmbodiChain writes it. EmbodiChain's observation of the
    same name gives a nested dictionary; here it is one vector, that a learner can take.

    Example:
        ``{func: get_articulation_joint_drive, params: {entity_cfg: {uid: ur10}, gains:
        [damping]}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        gains: Which properties, in the order wanted.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        gains: Gains = _ALL_GAINS,
    ) -> None:
        self._of, self._gains = Joints(entity_cfg), list(gains)

    def value(self) -> F64:
        """(N, K x gains)."""
        drives = self._of.asset.drives
        parts = [getattr(drives, name)[:, self._of.ids] for name in self._gains]
        found: F64 = np.minimum(np.concatenate(parts, axis=1), _NO_LIMIT)
        return found
