"""Events that place objects where a robot's tool can reach them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Box3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ik import solve
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.lab.gym.envs.mdp.events.eef_pose import reach_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, quat_multiply, quat_to_matrix

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["SampleRigidObjectPoseFromWorkspace"]


@register_term("event", name="sample_rigid_object_pose_from_workspace")
class SampleRigidObjectPoseFromWorkspace(Term):
    """Places a rigid object at a random position that a robot's tool can reach; stops it.

    Positions are drawn uniformly from a box until inverse kinematics (from the robot's initial
    joint positions, orientation free) brings the tool there; an environment without success after
    `max_attempts` keeps the object where it is. EmbodiChain's event of the same name, which draws
    from a workspace computed before; its `strategy`, `min_score` and `use_workspace_orientation`
    belong to that and do not exist here.

    Args:
        robot_cfg: The robot; control parts or joint names pick the joints, a link name the tool.
        entity_cfg: The object.
        position_bounds: [[x, y, z] low, [x, y, z] high] in metres, environment's frame.
        control_part: Picks the joints by a control part instead.
        reference_height: If given, the height of the position in metres, whatever the box says.
        rotation_range: [[x, y, z] low, [x, y, z] high] Euler angles in **degrees**, intrinsic XYZ,
            that turn the object's initial orientation, in its own frame.
        max_attempts: Positions tried at most.

    Example:
        ``{func: sample_rigid_object_pose_from_workspace, mode: reset, params: {robot_cfg: {uid: ur10, link_names: [ee_link]}, entity_cfg: {uid: goal}, position_bounds: [[-1, -1, 0.2], [1, 1, 1.8]]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        robot_cfg: ResolvedEntity,
        entity_cfg: ResolvedEntity,
        position_bounds: Box3,
        control_part: str | None = None,
        reference_height: float | None = None,
        rotation_range: Box3 | None = None,
        max_attempts: Annotated[int, Field(ge=1)] = 64,
    ) -> None:
        if not hasattr(entity_cfg.asset, "is_non_dynamic"):
            message = f"{entity_cfg.uid!r} is not a rigid object"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        if control_part is not None:
            links = list(robot_cfg.link_names) or None
            picked = {"uid": robot_cfg.uid, "control_parts": control_part, "link_names": links}
            robot_cfg = env.scene_entity(picked)
        self._reach = reach_of(robot_cfg, "robot_cfg")
        self._robot, self._asset = robot_cfg.asset, entity_cfg.asset
        low, high = (np.array(row, np.float64) for row in position_bounds)
        if reference_height is not None:
            low[2] = high[2] = reference_height
        self._box = constant(low), constant(high)
        self._angles: tuple[F64, F64] | None = None
        if rotation_range is not None:
            self._angles = (
                constant(np.deg2rad(rotation_range[0])),
                constant(np.deg2rad(rotation_range[1])),
            )
        self._attempts = max_attempts
        count = env.num_envs
        self._home: F64 = np.tile(np.asarray(self._robot.parsed.init_qpos, np.float64), (count, 1))
        self._quat0: F64 = np.tile(np.asarray(self._asset.entity.quat0, np.float64), (count, 1))

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw positions until each of these environments has one; place the object."""
        left: EnvIndex = np.arange(env.num_envs) if env_ids is None else env_ids
        places: F64 = np.zeros((env.num_envs, 3))
        root_pos, root_quat = self._robot.read_pose()
        found = []
        for _ in range(self._attempts):
            pos = env.event_manager.draw("position", (3,), *self._box, left)
            frame = root_pos[left], quat_to_matrix(root_quat[left])
            solved = solve(self._reach, *frame, self._home[left], pos, None)[1]
            places[left[solved]] = pos[solved]
            found.append(left[solved])
            left = left[~solved]
            if not len(left):
                break
        ids = np.sort(np.concatenate(found))
        if len(ids):
            self._place(env, places[ids], ids)

    def _place(self, env: TermContext, pos: F64, ids: EnvIndex) -> None:
        quat: Any = self._quat0[: len(ids)]
        if self._angles is not None:
            angles = env.event_manager.draw("rotation", (3,), *self._angles, ids)
            quat = quat_multiply(quat, euler_xyz_to_quat(angles))
        self._asset.write_pose(pos, quat, ids)
        self._asset.stop(ids)
