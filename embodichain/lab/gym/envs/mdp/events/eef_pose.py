"""Events that move a robot's tool by inverse kinematics."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Box3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ik import Reach, solve
from embodichain.lab.gym.envs.mdp._kinematics import Chain, matmul, tool_links
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, quat_to_matrix

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["RandomizeRobotEefPose", "reach_of"]


def reach_of(entity: ResolvedEntity, path: str = "entity_cfg") -> Reach:
    """The tool and the joints that move it, from a robot's picked joints and link.

    Args:
        entity: The robot. Without a picked link the tool is the picked part's tool point, else
            the link farthest from its base among those that all picked joints move.
        path: The parameter, for messages.

    Raises:
        ConfigError: If there is no such link or more than one, or no picked joint moves it.
    """
    asset = entity.asset
    if not entity.joint_ids:
        raise ConfigError([Problem(f"{path}.uid", f"{entity.uid!r} has no joints")])
    links = list(entity.link_ids) or tool_links(entity)
    if len(links) != 1:
        names = [asset.parsed.link_names[link] for link in links]
        message = f"name one link as the tool; the picked joints suggest {names or 'none'}"
        raise ConfigError([Problem(f"{path}.link_names", message)])
    chain = Chain(asset, int(asset.entity.body_ids[links[0]]))
    moving = np.isin(chain.columns, np.asarray(entity.joint_ids))
    if not moving.any():
        tool = asset.parsed.link_names[links[0]]
        message = f"none of the picked joints moves {tool!r}"
        raise ConfigError([Problem(f"{path}.link_names", message)])
    low, high = np.asarray(asset.parsed.qpos_limits, np.float64).T
    return Reach(chain, moving, low, high)


@register_term("event", name="randomize_robot_eef_pose")
class RandomizeRobotEefPose(Term):
    """Moves a robot's tool away from where it is, by inverse kinematics; the robot stands still.

    The tool's pose is moved by U(position_range) in the environment's axes and turned by
    U(rotation_range) in its own; joints are solved for from where they are (damped least squares,
    `mdp/_ik.py`), and drive targets follow. An environment in which the pose is out of reach keeps
    its joints. EmbodiChain's event of the same name.

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
        self._reach = reach_of(entity_cfg)
        self._box: tuple[F64, F64] | None = None
        if position_range is not None:
            self._box = constant(position_range[0]), constant(position_range[1])
        self._angles: tuple[F64, F64] | None = None
        if rotation_range is not None:
            low, high = (np.deg2rad(np.asarray(row, np.float64)) for row in rotation_range)
            self._angles = constant(low), constant(high)
        index = asset.entity
        self._dofs = np.asarray(index.dof_adr, np.int64)
        self._driven = np.flatnonzero(np.asarray(index.actuator_ids) >= 0)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw, solve and write the joint positions of these environments."""
        asset, reach = self._asset, self._reach
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        root_pos, root_quat = asset.read_pose()
        frame = root_pos[ids], quat_to_matrix(root_quat[ids])
        qpos = asset.read_qpos()[ids]
        now = reach.chain.posture(*frame, qpos)
        pos, mat = now.pos, now.mat
        if self._box is not None:
            pos = pos + env.event_manager.draw("position", (3,), *self._box, env_ids)
        if self._angles is not None:
            angles = env.event_manager.draw("rotation", (3,), *self._angles, env_ids)
            mat = matmul(mat, quat_to_matrix(euler_xyz_to_quat(angles)))
        found, solved = solve(reach, *frame, qpos, pos, mat)
        qpos = np.where(solved[:, None], found, qpos)
        asset.write_qpos(qpos, None, env_ids)
        asset.engine.write("qvel", 0.0, env_ids, self._dofs)
        if len(self._driven):
            asset.write_target(qpos[:, self._driven], self._driven, env_ids)
