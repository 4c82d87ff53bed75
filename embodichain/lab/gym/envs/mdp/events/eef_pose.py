"""The event that moves a robot's tool by inverse kinematics."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.drawing import Uniform
from embodichain.lab.gym.envs.managers.param_types import Box3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ik import Reach
from embodichain.utils.math import euler_xyz_to_quat, quat_multiply

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["RandomizeRobotEefPose"]


@register_term("event", name="randomize_robot_eef_pose")
class RandomizeRobotEefPose(Term):
    """Moves a robot's tool away from where it is, by inverse kinematics; the robot stops.

    The tool's pose is moved by U(position_range) in the environment's axes and turned by
    U(rotation_range) in its own; joints are solved for from where they are (damped least squares),
    and drive targets follow. An environment in which the pose is out of reach keeps its joints.
    EmbodiChain's event of the same name.

    Args:
        entity_cfg: The robot; control parts or joint names pick the joints that move, a link name
            picks the tool (else it is the link farthest from the base that they move).
        position_range: [[x, y, z] low, [x, y, z] high] in metres; None keeps the position.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ; None keeps the
            orientation.

    Example:
        ``{func: randomize_robot_eef_pose, mode: reset, params: {entity_cfg: {uid: ur10, link_names: [ee_link]}, position_range: [[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]], rotation_range: [[-10, -10, -10], [10, 10, 10]]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        position_range: Box3 | None = None,
        rotation_range: Box3 | None = None,
    ) -> None:
        self._asset = asset = entity_cfg.asset
        self._reach = Reach(entity_cfg)
        self._position = Uniform.within("position", position_range)
        self._rotation = Uniform.within("rotation", rotation_range, degrees=True)
        index = asset.entity
        self._dofs = np.asarray(index.dof_adr, np.int64)
        self._driven = np.flatnonzero(np.asarray(index.actuator_ids) >= 0)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw, solve and write the joint positions of these environments."""
        asset, engine, body = self._asset, self._asset.engine, self._reach.body
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        pos, quat = engine.derived("xpos")[ids, body], engine.derived("xquat")[ids, body]
        if self._position is not None:
            pos = pos + self._position(env.event_manager, env_ids)
        if self._rotation is not None:
            angles = self._rotation(env.event_manager, env_ids)
            quat = quat_multiply(quat, euler_xyz_to_quat(angles))
        root_pos, root_quat = (part[ids] for part in asset.read_pose())
        qpos = asset.read_qpos()[ids]
        found, solved = self._reach.solve(root_pos, root_quat, qpos, pos, quat)
        qpos = np.where(solved[:, None], found, qpos)
        asset.write_qpos(qpos, None, env_ids)
        engine.write("qvel", 0.0, env_ids, self._dofs)
        if len(self._driven):
            asset.write_target(qpos[:, self._driven], self._driven, env_ids)
