"""Commands that ask for a pose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Box3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import CommandMarker, CommandTerm, Uniform
from embodichain.lab.gym.envs.mdp._rows import angle_between, norm
from embodichain.utils.math import euler_xyz_to_quat, quat_multiply, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import F64, EnvIndex

__all__ = ["UniformPoseCommand"]


@register_term("command", name="uniform_pose")
class UniformPoseCommand(CommandTerm):
    """(N, 7) pose x, y, z, qw, qx, qy, qz in the frame of an entity's root, drawn uniformly.

    After Isaac Lab's ``UniformPoseCommand``. If a link is picked, the metrics ``position_error``
    (m) and ``orientation_error`` (rad) are its distances from the commanded pose.

    Example:
        ``{func: uniform_pose, params: {of: {uid: go}, position_range: [[0,0,0],[1,1,1]]}}``

    Args:
        entity_cfg: The entity whose root is the frame, and the link that should go there.
        position_range: [[x, y, z] low, [x, y, z] high], m.
        euler_range: The same for Euler angles in rad, intrinsic XYZ (R = Rx Ry Rz); None is the
            frame's own orientation.
        make_quat_unique: Whether to choose qw >= 0 of the two quaternions of a rotation.
    """

    names = ("x", "y", "z", "qw", "qx", "qy", "qz")

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        position_range: Box3,
        euler_range: Box3 | None = None,
        make_quat_unique: bool = False,
    ) -> None:
        self._env = env
        self._entity = entity_cfg
        self._root = ResolvedEntity(entity_cfg.uid, entity_cfg.asset)
        angles = [[0.0] * 3] * 2 if euler_range is None else euler_range
        self._turns = euler_range is not None
        ends = ([*position_range[i], *angles[i]] for i in (0, 1))
        self._pose = Uniform("pose", *ends)
        self._unique = make_quat_unique
        self.values: F64 = np.zeros((env.num_envs, 7))
        self.values[:, 3] = 1.0
        self.marker = CommandMarker("pose", self._root.body_id)

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw poses."""
        drawn = self._pose(self._env.command_manager, env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        self.values[where, :3] = drawn[:, :3]
        if not self._turns:
            return
        quat = euler_xyz_to_quat(drawn[:, 3:])
        if self._unique:
            quat = np.where(quat[:, :1] < 0.0, -quat, quat)
        self.values[where, 3:] = quat

    def world(self) -> tuple[F64, F64]:
        """The commanded position (N, 3) and wxyz orientation (N, 4) in the environment's frame."""
        turn = self._root.orientation()
        position = self._root.position() + quat_rotate(turn, self.values[:, :3])
        return position, quat_multiply(turn, self.values[:, 3:])

    def metrics(self) -> Mapping[str, F64]:
        """Distance of the picked link from the command."""
        if not self._entity.link_names:
            return {}
        position, quat = self.world()
        return {
            "position_error": norm(self._entity.position() - position),
            "orientation_error": angle_between(self._entity.orientation(), quat),
        }
