"""EmbodiChain's events that place objects, tables and targets, and a push at random times."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from embodichain.compat.terms._targets import RigidObject, asset_of, get_or_create
from embodichain.lab.gym.envs.managers.param_types import (
    Arm,
    Axes6,
    Body,
    Box2,
    Box3,
    Finite,
    Range,
    Whole,
)
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._ground import above_ground, ground_of
from embodichain.lab.gym.envs.mdp._tools import arm_solver
from embodichain.lab.gym.envs.mdp.events.pushes import EpisodeTimer, PushBySettingVelocity
from embodichain.utils.arrays import rows_at, tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, pose_to_matrix, quat_multiply

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = [
    "PlannerGridCellSampler",
    "PushArticulation",
    "RandomizeAnchorHeight",
    "RandomizeTargetPose",
    "SampleRigidObjectPoseFromWorkspace",
]

Count = Annotated[int, Field(ge=1)]


def _initial_quats(env: TermContext, asset: Any) -> Floats:
    """(N, 4) initial orientation."""
    quat0 = np.asarray(asset.index.quat0, np.float64)
    quats: Floats = env.arrays.put(np.tile(quat0, (env.num_envs, 1)))
    return quats


@register_term("event", name="sample_rigid_object_pose_from_workspace")
class SampleRigidObjectPoseFromWorkspace(Term):
    """Places a rigid object at a random position that a robot's tool can reach, with velocity 0.

    Positions are drawn uniformly from a box until inverse kinematics (from the robot's initial
    joint positions, orientation free) brings the tool there; an environment without success after
    `max_attempts` keeps the object where it is. EmbodiChain draws from a precomputed workspace; the
    parameters `strategy`, `min_score` and `use_workspace_orientation` belong to that.

    Args:
        robot_cfg: The robot; control parts or joint names pick the joints, a link name the tool.
        entity_cfg: The object.
        position_bounds: [[x, y, z] low, [x, y, z] high] in metres, environment's frame.
        control_part: Picks the joints by a control part instead.
        reference_height: If given, the height of the position in metres, instead of the box's.
        rotation_range: [[x, y, z] low, [x, y, z] high] Euler angles in **degrees**, intrinsic XYZ,
            that turn the object's initial orientation, in its own frame.
        max_attempts: Positions tried at most.

    Example:
        ``{func: sample_rigid_object_pose_from_workspace, mode: reset, params: {robot_cfg: {uid: ur10, link_names: [ee_link]}, of: {uid: goal}, position_bounds: [[-1, -1, 0.2], [1, 1, 1.8]]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        robot_cfg: Arm,
        entity_cfg: RigidObject,
        position_bounds: Box3,
        control_part: str | None = None,
        reference_height: float | None = None,
        rotation_range: Box3 | None = None,
        max_attempts: Annotated[int, Field(ge=1)] = 64,
    ) -> None:
        if control_part is not None:
            reference = {"uid": robot_cfg.uid, "control_parts": control_part}
            if robot_cfg.frame_name is not None:
                reference[robot_cfg.kind] = robot_cfg.frame_name
            robot_cfg = env.scene_entity(reference)
        env.arrays.require_host("searches for joint positions")
        self._arm = arm_solver(robot_cfg, "robot_cfg")
        self._robot = robot_cfg.articulation
        self._asset = entity_cfg.asset
        box = np.array(position_bounds, np.float64)
        if reference_height is not None:
            box[:, 2] = reference_height
        self._position = Uniform("position", box[0], box[1])
        self._rotation = Uniform.within("rotation", rotation_range, degrees=True)
        self._attempts = max_attempts
        init_qpos = np.asarray(self._robot.parsed.init_qpos, np.float64)
        self._home: Floats = np.tile(init_qpos, (env.num_envs, 1))
        self._quat0 = _initial_quats(env, self._asset)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw positions until each of these environments has one; place the object."""
        unsolved: EnvIndex = np.arange(env.num_envs) if env_ids is None else env_ids
        positions: Floats = np.zeros((env.num_envs, 3))
        solved_ids = []
        for _ in range(self._attempts):
            pos = self._position(env.event_manager, unsolved)
            _, solved = self._arm.inverse(self._home[unsolved], pos, None, unsolved, restarts=False)
            positions[unsolved[solved]] = pos[solved]
            solved_ids.append(unsolved[solved])
            unsolved = unsolved[~solved]
            if not len(unsolved):
                break
        ids = np.sort(np.concatenate(solved_ids))
        if len(ids):
            self._place(env, positions[ids], ids)

    def _place(self, env: TermContext, pos: Floats, ids: EnvIndex) -> None:
        """Place the object, turned by a draw from its initial orientation."""
        quat = self._quat0[: len(ids)]
        if self._rotation is not None:
            angles = self._rotation(env.event_manager, ids)
            quat = quat_multiply(quat, euler_xyz_to_quat(angles))
        self._asset.write_pose(pos, quat, ids)
        self._asset.stop(ids)


@register_term("event", name="planner_grid_cell_sampler")
class PlannerGridCellSampler(Term):
    """Places objects at the centres of cells of a grid, each in another cell, with velocity 0.

    The rectangle is divided into rows (along x) and columns (along y) of equal cells; cells are
    drawn uniformly without replacement (the order of one uniform number a cell). Orientations are
    the objects' initial ones.

    Args:
        position_range: [[x, y] low, [x, y] high] in metres, environment's frame.
        reference_height: Height of the objects' origins in metres; on a terrain above the ground.
        object_uid_list: Rigid objects; at most as many as there are cells.
        grid_size: [rows, columns].
        physics_update_step: Physics steps that these environments take afterwards; -1 or 0 takes
            none.

    Example:
        ``{func: planner_grid_cell_sampler, mode: reset, params: {position_range: [[0.4, -0.3], [0.8, 0.3]], reference_height: 0.06, object_uid_list: [cube, goal], grid_size: [3, 4]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        position_range: Box2,
        reference_height: float,
        object_uid_list: Annotated[list[str], Field(min_length=1)],
        grid_size: Annotated[list[Count], Field(min_length=2, max_length=2)],
        physics_update_step: Annotated[int, Field(ge=-1)] = -1,
    ) -> None:
        rows, columns = grid_size
        if len(object_uid_list) > rows * columns:
            message = f"{len(object_uid_list)} objects do not fit into {rows} x {columns} cells"
            raise ConfigError([Problem("grid_size", message)])
        if len(set(object_uid_list)) < len(object_uid_list):
            raise ConfigError([Problem("object_uid_list", "names an object twice")])
        self._assets = [
            asset_of(env, uid, f"object_uid_list.{number}", objects_only=True)
            for number, uid in enumerate(object_uid_list)
        ]
        self._quats = [_initial_quats(env, asset) for asset in self._assets]
        self._centres = _centres(position_range, rows, columns, reference_height)
        self._ground = ground_of(env)
        self._keys = Uniform("cells", np.zeros(rows * columns), np.ones(rows * columns))
        self._steps = physics_update_step
        if physics_update_step > 0:
            env.arrays.require_host("physics steps of some environments", "physics_update_step")

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw cells and place the objects of these environments."""
        keys = self._keys(env.event_manager, env_ids)
        order = np.argsort(keys, axis=1, kind="stable")
        for number, asset in enumerate(self._assets):
            pos = above_ground(self._ground, rows_at(self._centres, order[:, number]), env_ids)
            asset.write_pose(pos, self._quats[number][: len(pos)], env_ids)
            asset.stop(env_ids)
        if self._steps > 0:
            env.sim.engine.step(self._steps, env_ids)


def _centres(box: Box2, rows: int, columns: int, height: float) -> Floats:
    """(rows * columns, 3) centres of the cells, row by row."""
    (x0, y0), (x1, y1) = box
    x = x0 + (np.arange(rows) + 0.5) * (x1 - x0) / rows
    y = y0 + (np.arange(columns) + 0.5) * (y1 - y0) / columns
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.concatenate([grid, np.full((len(grid), 1), height)], axis=1)


@register_term("event", name="randomize_anchor_height")
class RandomizeAnchorHeight(Term):
    """Raises an anchor (a table) by a random height, and every dynamic object with it.

    The anchor's height is its initial one, on a terrain above the ground, plus the draw; dynamic
    objects move by as much as the anchor does.

    Args:
        anchor_uid: A rigid object, or a robot or articulation.
        height_delta_range: [low, high] in metres, uniform; or
        height_delta_candidates: heights in metres, one of which is picked with equal probability.
        exclude_uids: Dynamic objects that stay.
        store_key: If given, ``env.<store_key>`` contains the heights drawn, (N,) float32 metres.

    Example:
        ``{func: randomize_anchor_height, mode: reset, params: {anchor_uid: goal, height_delta_range: [-0.05, 0.05], exclude_uids: [cube]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        anchor_uid: str,
        height_delta_range: Range | None = None,
        height_delta_candidates: Annotated[list[Finite], Field(min_length=1)] | None = None,
        exclude_uids: list[str] | None = None,
        store_key: str | None = None,
    ) -> None:
        if (height_delta_range is None) == (height_delta_candidates is None):
            message = "give either height_delta_range or height_delta_candidates"
            raise ConfigError([Problem("height_delta_range", message)])
        self._env = env
        self._key = store_key
        self._ground = ground_of(env)
        self._anchor = asset_of(env, anchor_uid, "anchor_uid")
        excluded = {anchor_uid}
        for number, uid in enumerate(exclude_uids or ()):
            excluded.add(asset_of(env, uid, f"exclude_uids.{number}").uid)
        self._carried = [
            handle
            for uid, handle in env.sim.rigid_objects.items()
            if not handle.is_non_dynamic and uid not in excluded
        ]
        self._candidates: Floats | None = None
        bounds: Any = height_delta_range
        if height_delta_candidates is not None:
            self._candidates = np.asarray(height_delta_candidates, np.float64)
            bounds = (0.0, float(len(self._candidates)))  # the index of one of them
        self._height = Uniform("height", [bounds[0]], [bounds[1]])
        self._delta: Floats = env.arrays.full(env.num_envs, 0.0)
        if store_key is not None:
            get_or_create(env, store_key, lambda: tensor_of(self._heights()), "store_key")

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Clear the draws, as a reset restores the configured heights."""
        self._delta[slice(None) if env_ids is None else env_ids] = 0.0

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw heights and move the anchor and the objects on it in these environments."""
        where: Any = slice(None) if env_ids is None else env_ids
        height = self._height(env.event_manager, env_ids)[:, 0]
        if self._candidates is not None:
            height = rows_at(self._candidates, height.astype(np.int64))
        pos = self._anchor.read_pose()[0][where].copy()
        pos[:, 2] = float(self._anchor.index.pos0[2]) + height
        self._anchor.write_pose(above_ground(self._ground, pos, env_ids), None, env_ids)
        for handle in self._carried:
            pos = handle.read_pose()[0][where].copy()
            pos[:, 2] += height - self._delta[where]
            handle.write_pose(pos, None, env_ids)
        self._delta[where] = height
        self._publish()

    def _publish(self) -> None:
        """Store the heights as an attribute of the environment."""
        if self._key is not None:
            setattr(self._env, self._key, tensor_of(self._heights()))

    def _heights(self) -> NDArray[np.float32]:
        return self._delta.astype(np.float32)

    def state_dict(self) -> dict[str, Any]:
        """The current heights (a copy)."""
        return {"delta": self._delta.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._delta[:] = state["delta"]
        self._publish()


@register_term("event", name="randomize_target_pose")
class RandomizeTargetPose(Term):
    """Draws a target pose and stores it as ``env.<store_key>``, (N, 4, 4) float32 matrices.

    Terms such as `distance_to_target` read it there. Until the first draw the pose is the identity.

    Args:
        position_range: [[x, y, z] low, [x, y, z] high] in metres.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ (R = Rx Ry Rz);
            None keeps the orientation of the reference (no rotation without one).
        relative_position: True adds the draw to the reference's position at that time, False takes
            it as the position in the environment's frame.
        relative_rotation: True turns the reference's orientation by the draw, in its own frame.
        reference_entity_cfg: An entity, or a link of one; needed by a relative pose.
        store_key: The attribute of the environment.

    Example:
        ``{func: randomize_target_pose, mode: reset, params: {position_range: [[0.3, -0.3, 0.5], [0.7, 0.3, 0.9]], store_key: target_pose}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        position_range: Box3,
        rotation_range: Box3 | None = None,
        relative_position: bool = False,
        relative_rotation: bool = False,
        reference_entity_cfg: Body | None = None,
        store_key: str = "target_pose",
    ) -> None:
        if reference_entity_cfg is None:
            relative_params = {
                "relative_position": relative_position,
                "relative_rotation": relative_rotation,
            }
            for name, is_relative in relative_params.items():
                if is_relative:
                    message = "needs reference_entity_cfg: relative to what?"
                    raise ConfigError([Problem(name, message)])
        self._env = env
        self._key = store_key
        self._reference = reference_entity_cfg
        self._moves = relative_position
        self._turns = relative_rotation
        self._position = Uniform("position", *position_range)
        self._rotation = Uniform.within("rotation", rotation_range, degrees=True)
        count = env.num_envs
        identity_quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (count, 1))
        self._identity_quats: Floats = env.arrays.put(identity_quats)
        identities = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1))
        first_poses = tensor_of(env.arrays.put(identities))
        get_or_create(env, store_key, lambda: first_poses, "store_key")

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw the target poses of these environments."""
        where: Any = slice(None) if env_ids is None else env_ids
        pos = self._position(env.event_manager, env_ids)
        quat = self._identity_quats[: len(pos)]
        if self._reference is not None:
            quat = self._reference.orientation()[where]
            if self._moves:
                pos = self._reference.position()[where] + pos
        if self._rotation is not None:
            rotation = euler_xyz_to_quat(self._rotation(env.event_manager, env_ids))
            quat = quat_multiply(quat, rotation) if self._turns else rotation
        matrices = pose_to_matrix(np.concatenate([pos, quat], axis=1))
        # A new tensor: references to the old one keep its values.
        poses = env.arrays.of(getattr(env, self._key)).copy()
        poses[where] = matrices
        setattr(env, self._key, tensor_of(poses))

    def state_dict(self) -> dict[str, Any]:
        """The poses (a copy)."""
        return {"poses": getattr(self._env, self._key).clone()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        setattr(self._env, self._key, state["poses"].clone())


@register_term("event", name="push_articulation_by_setting_velocity", takes_strength=True)
class PushArticulation(PushBySettingVelocity):
    """`push_by_setting_velocity` at its own times.

    Give it `mode: interval` and `interval_step: 1`: it counts control steps. Each environment is
    pushed after a time drawn from `interval_range_s`, counted from its last push or from the
    beginning of its episode.

    Args:
        entity_cfg: A robot with a floating base, or a dynamic object.
        interval_range_s: [low, high] seconds between pushes, positive.
        velocity_range: See `push_by_setting_velocity`.

    Example:
        ``{func: push_articulation_by_setting_velocity, mode: interval, interval_step: 1, params: {of: {uid: go}, interval_range_s: [5, 10], velocity_range: {x: [-0.5, 0.5]}}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        interval_range_s: Range,
        velocity_range: Axes6,
    ) -> None:
        super().__init__(env, entity_cfg, velocity_range)
        self._interval = EpisodeTimer.seconds("interval", "interval_range_s", interval_range_s)
        self._timer = EpisodeTimer(env)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Draw a new time for environments that begin an episode."""
        self._timer.reset(env_ids)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Push the environments for which a push is due."""
        self._timer.start(self._interval, self._timer.stopped(env_ids))
        due = self._timer.advance(env_ids)
        if len(due):
            super().__call__(env, due)
            self._timer.start(self._interval, due)

    def state_dict(self) -> dict[str, Any]:
        """The times of the next pushes."""
        return self._timer.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._timer.load_state_dict(state)
