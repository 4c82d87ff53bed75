"""Events that place whole entities: objects, roots of robots, and tools.

A free joint stores its linear velocity in the environment's axes and its angular one in the body's;
velocities here are in the environment's.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Arm, Axes6, Body, Box3, Range, Whole
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._ground import above_ground, ground_of
from embodichain.lab.gym.envs.mdp._reach import fitted_share, initial_pose_of
from embodichain.lab.gym.envs.mdp._tools import arm_solver
from embodichain.utils.arrays import contiguous, is_host
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import (
    euler_xyz_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    rpy_to_quat,
)
from embodichain.utils.random import RandomStreams

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.objects.rigid_object import RigidObject
    from embodichain.utils.array_types import Floats

__all__ = [
    "AXES",
    "RandomizeObjectPositionInShell",
    "RandomizePose",
    "RandomizeRobotEefPose",
    "ResetRootStateUniform",
    "need_free_root",
    "read_root_velocity",
    "reset_scene_to_default",
    "six_axes",
    "write_root_velocity",
]

_log = logging.getLogger(__name__)
AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def six_axes(
    name: str, ranges: Mapping[Any, Sequence[float]] | None, default: float | None = None
) -> Uniform | None:
    """A draw of shape (6,) from a map from axes to [low, high]; absent axes are 0.

    None if the map is empty. `default` is that of `Uniform`.
    """
    if not ranges:
        return None
    low, high = np.array([ranges.get(axis, (0.0, 0.0)) for axis in AXES], np.float64).T
    return Uniform(name, low, high, default)


def need_free_root(entity: ResolvedEntity) -> None:
    """Check that the root of an entity has a velocity.

    Raises:
        ConfigError: If its base is fixed, or it is an object that is not dynamic.
    """
    if entity.asset.index.free_qvel_adr < 0:
        message = (
            f"{entity.uid!r} cannot get a velocity: it needs body_type: dynamic (an object) or "
            "fix_base: false (a robot)"
        )
        raise ConfigError([Problem("entity_cfg.uid", message)])


def read_root_velocity(asset: Articulation | RigidObject) -> Floats:
    """(N, 6) linear velocity of the root's origin in m/s, then angular in rad/s; a copy."""
    first = asset.index.free_qvel_adr
    qvel = asset.engine.state("qvel")[:, first : first + 6]
    _, quat = asset.read_pose()
    return np.concatenate([qvel[:, :3], quat_rotate(quat, qvel[:, 3:])], axis=1)


def write_root_velocity(
    asset: Articulation | RigidObject, velocity: Floats, env_ids: EnvIndex | None
) -> None:
    """Set the root's velocity.

    Args:
        asset: A handle with a free root.
        velocity: (n, 6) linear in m/s, then angular in rad/s.
        env_ids: (n,) environments, or None for all.
    """
    first = asset.index.free_qvel_adr
    _, quat = asset.read_pose()
    if env_ids is not None:
        quat = quat[env_ids]
    angular = quat_rotate(quat_conjugate(quat), velocity[:, 3:])
    qvel = np.concatenate([velocity[:, :3], angular], axis=1)
    asset.engine.write("qvel", qvel, env_ids, slice(first, first + 6))


@register_term("event")
def reset_scene_to_default(env: TermContext, env_ids: EnvIndex | None) -> None:
    """Resets every entity to its configured state: poses, joints, drive targets, velocity 0.

    Isaac Lab's event. A reset already does this before events run; as an `interval` event it resets
    the scene within an episode. Entities that are excluded from resets are reset too.

    Args:
        env: The environment.
        env_ids: (n,) environments, or None for all.

    Example:
        ``{func: reset_scene_to_default, mode: interval, interval_step: 100}``
    """
    env.sim.reset_objects_state(env_ids)


@register_term("event", name="reset_root_state_uniform")
class ResetRootStateUniform(Term):
    """Offsets an entity's root from its configured pose at random, and sets a random velocity.

    pos = pos0 + U(x, y, z); quat = quat0 * q(roll, pitch, yaw) with q = Rz Ry Rx: the rotation is
    in the entity's frame; velocity = U. Isaac Lab's event of the same name. On a terrain heights
    count from the ground below the root's origin: leave room for a step beside it.

    Args:
        entity_cfg: A rigid object or a robot.
        pose_range: {x, y, z: [low, high] in metres; roll, pitch, yaw: [low, high] in rad}. An axis
            that is absent is 0.
        velocity_range: {x, y, z: [low, high] in m/s; roll, pitch, yaw: in rad/s}, environment's
            axes. Needs a dynamic object or a floating base; joints do not change.

    Example:
        ``{func: reset_root_state_uniform, mode: reset, params: {of: {uid: cube}, pose_range: {x: [-0.2, 0.2], yaw: [-3.14, 3.14]}, velocity_range: {z: [-0.5, 0.5]}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        pose_range: Axes6 | None = None,
        velocity_range: Axes6 | None = None,
    ) -> None:
        self._pose = six_axes("pose", pose_range)
        self._velocity = six_axes("velocity", velocity_range)
        if self._velocity is not None:
            need_free_root(entity_cfg)
        self._asset = entity_cfg.asset
        self._ground = ground_of(env)
        index = entity_cfg.asset.index
        self._has_velocity = index.free_qvel_adr >= 0
        self._pos0 = _rows_of(index.pos0, env)
        self._quat0 = _rows_of(index.quat0, env)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the root states of these environments."""
        count = env.num_envs if env_ids is None else len(env_ids)
        pos = self._pos0[:count]
        quat = self._quat0[:count]
        if self._pose is not None:
            drawn = self._pose(env.event_manager, env_ids)
            pos = pos + drawn[:, :3]
            quat = quat_multiply(quat, rpy_to_quat(drawn[:, 3:]))
        asset = self._asset
        asset.write_pose(above_ground(self._ground, pos, env_ids), quat, env_ids)
        if self._velocity is not None:
            velocity = self._velocity(env.event_manager, env_ids)
            write_root_velocity(asset, velocity, env_ids)
        elif self._has_velocity:
            # (n, 6) zeros where `pos` is: on the host or on a device.
            zeros = np.zeros_like(pos[:, :1]) * np.zeros(6)
            write_root_velocity(asset, zeros, env_ids)


def _rounded(quat: Floats) -> Floats:
    """(4,) an orientation to a thousandth, normalized, its first part that is not 0 positive."""
    rounded = np.round(quat, 3) + 0.0  # no -0
    first = rounded[np.flatnonzero(rounded)[0]]
    rounded = np.where(rounded == 0.0, 0.0, rounded * np.sign(first))
    normalized: Floats = rounded / np.sqrt((rounded * rounded).sum())
    return normalized


def _rows_of(row: Any, env: TermContext) -> Floats:
    """(N, K) the same row (K,) for every environment."""
    return env.arrays.put(np.tile(np.asarray(row, np.float64), (env.num_envs, 1)))


@register_term("event", name="randomize_pose")
class RandomizePose(Term):
    """Places an object, or the root of a robot or articulation, at random, with velocity 0.

    The pose is the declared initial pose plus uniform draws. Joint positions do not change. On a
    terrain heights count from the ground below its origin, unless it is `relative_to` another.

    Args:
        entity_cfg: The object, robot or articulation.
        position_range: [[x, y, z] low, [x, y, z] high] in metres; None draws no position.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ (R = Rx Ry Rz);
            None keeps the initial orientation.
        relative_position: True adds the draw to the initial position (or to `relative_to`), False
            uses it as the position in the environment's frame.
        relative_rotation: True rotates the initial orientation by the draw, in the entity's frame;
            False uses it as the orientation.
        relative_to: An entity, or a link, site or geom of one; the draw is added to its present position instead
            of the initial one. Its orientation is not used.
        turned_as: An entity, or a link, site or geom of one, whose orientation at the start of the
            run, to a thousandth, stands for the initial one.
        reachable_by: An action term that moves a tool. The position range is made smaller, as a
            whole, until the tool reaches 19 of 20 places in it within the action's bounds; with
            `turned_as` in the orientations that the entity has there. Needs `relative_to`.
        physics_update_step: Physics steps of these environments afterwards, so that the entity
            can settle; -1 or 0 is none.

    Example:
        ``{func: randomize_pose, mode: reset, params: {of: {uid: cube}, position_range: [[-0.1, -0.1, 0], [0.1, 0.1, 0]], rotation_range: [[0, 0, -180], [0, 0, 180]]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        position_range: Box3 | None = None,
        rotation_range: Box3 | None = None,
        relative_position: bool = True,
        relative_rotation: bool = False,
        relative_to: Body | None = None,
        physics_update_step: Annotated[int, Field(ge=-1)] = -1,
        turned_as: Body | None = None,
        reachable_by: str | None = None,
    ) -> None:
        asset = entity_cfg.asset
        self._asset = asset
        self._stop: Callable[[EnvIndex | None], None] | None = None
        if entity_cfg.is_articulation:
            self._stop = entity_cfg.articulation.clear_dynamics
        elif not entity_cfg.rigid_object.is_non_dynamic:
            self._stop = entity_cfg.rigid_object.stop
        self._steps = physics_update_step
        if physics_update_step > 0:
            env.arrays.require_host("physics steps of some environments", "physics_update_step")
        if relative_to is not None and not relative_position:
            message = "relative_to needs relative_position: true"
            raise ConfigError([Problem("relative_position", message)])
        self._pos0 = _rows_of(asset.index.pos0, env)
        self._quat0 = _rows_of(asset.index.quat0, env)
        self._relative_to = relative_to
        self._ground = ground_of(env) if relative_to is None else None
        self._position: Uniform | None = None
        if position_range is not None:
            shift: Any = 0.0
            if relative_position and relative_to is None:
                # Added to the bounds, so that what is drawn and logged is the position. With
                # `relative_to` the log has the offset instead: the other position is not known yet.
                shift = np.asarray(asset.index.pos0, np.float64)
            low, high = (np.asarray(bound) + shift for bound in position_range)
            self._position = Uniform("position", low, high)
        self._rotation = Uniform.within("rotation", rotation_range, degrees=True)
        self._relative_rotation = relative_rotation
        self.fitted: dict[str, Any] = {}
        self._is_turned_as_tool = turned_as is not None
        if turned_as is not None:
            quat0 = _rounded(initial_pose_of(env, turned_as.frame)[1])
            self._quat0 = _rows_of(quat0, env)
            self._first_quat = quat0
            is_changed = not np.allclose(quat0, asset.index.quat0, rtol=0.0, atol=1e-9)
            self.fitted["turned_as"] = quat0.tolist() if is_changed else None
        self._reachable_by = reachable_by
        if reachable_by is not None and (relative_to is None or self._position is None):
            message = "reachable_by needs relative_to and position_range"
            raise ConfigError([Problem("reachable_by", message)])

    def prepare(self, env: TermContext) -> None:
        """Make the range of positions smaller until an arm reaches it, once."""
        name = self._reachable_by
        position = self._position
        if name is None or position is None or self._relative_to is None:
            return
        origin, _ = initial_pose_of(env, self._relative_to.frame)
        orientations: Floats | None = None
        if self._is_turned_as_tool:  # as it is drawn
            draws = RandomStreams(0, 1).uniform("reachable", (_DRAWS, 6))[0]
            offsets = position.low + draws[:, :3] * (position.high - position.low)
            orientations = self._orientations(draws[:, 3:])
        else:
            corners = np.stack(np.meshgrid(*([[0.0, 0.5, 1.0]] * 3), indexing="ij"), axis=-1)
            offsets = position.low + corners.reshape(-1, 3) * (position.high - position.low)
        share = fitted_share(env, name, origin, offsets, orientations)
        self.fitted["reachable_by"] = None if share == 1.0 else share
        if share < 1.0:
            _log.info("%s: places are drawn in to %g of the range", name, share)
            self._position = Uniform("position", share * position.low, share * position.high)
        self._reachable_by = None

    def _orientations(self, shares: Floats) -> Floats:
        """(n, 4) orientations for shares (n, 3), from 0 to 1, of the range of rotations."""
        quat0 = np.broadcast_to(np.asarray(self._first_quat), (len(shares), 4))
        rotation = self._rotation
        if rotation is None:
            return quat0
        quat = euler_xyz_to_quat(rotation.low + shares * (rotation.high - rotation.low))
        return quat_multiply(quat0, quat) if self._relative_rotation else quat

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the poses of these environments."""
        self.prepare(env)  # a term that replaces another one is not prepared yet
        quat0 = self._quat0 if env_ids is None else self._quat0[: len(env_ids)]
        quat: Floats | None = quat0
        if self._rotation is None and self._may_skip_orientation(quat0, env_ids):
            quat = None
        pos = self._pos0[: len(quat0)]
        if self._position is not None:
            pos = self._position(env.event_manager, env_ids)
        if self._relative_to is not None:
            origin = self._relative_to.position()
            if env_ids is not None:
                origin = origin[env_ids]
            pos = origin + (0.0 if self._position is None else pos)
        if self._rotation is not None:
            quat = euler_xyz_to_quat(self._rotation(env.event_manager, env_ids))
            if self._relative_rotation:
                quat = quat_multiply(quat0, quat)
        self._asset.write_pose(above_ground(self._ground, pos, env_ids), quat, env_ids)
        if self._stop is not None:
            self._stop(env_ids)
        if self._steps > 0:
            self._asset.engine.step(self._steps, env_ids)

    def _may_skip_orientation(self, quat: Floats, env_ids: EnvIndex | None) -> bool:
        """Whether these orientations need not be written, because the object has them.

        Results are the same either way; the write would only enlarge the log. Without a listener
        there is no log, and the answer is no: comparing would take longer than writing.
        """
        if self._stop is not None or not self._asset.engine.listeners or not is_host(quat):
            return False
        _, current_quat = self._asset.read_pose()
        if env_ids is not None:
            current_quat = current_quat[env_ids]
        return bool((current_quat == quat).all())


_DRAWS = 64
"""Poses that a tool must reach, as many of them as of draws."""
_RIGHT_ANGLE = 1.5707963267948966
_SPIRAL = 32
"""Places on a sphere that must be reached."""
_GOLDEN = 0.6180339887498949
"""Of a full turn, from one of these places to the next."""


@register_term("event", name="randomize_object_position_in_shell")
class RandomizeObjectPositionInShell(Term):
    """Places a rigid object between two spheres around an entity, uniformly in volume.

    With u uniform: r = cbrt(U(r0^3, r1^3)), azimuth = U, sin(elevation) = U(sin e0, sin e1). The
    object keeps its initial orientation.

    Args:
        entity_cfg: The object.
        relative_to: The entity, or link, site or geom of one, at the centre; its present position is used.
        radius_range: [low, high] in metres.
        azimuth_range: [low, high] in rad about z, from +x towards +y.
        elevation_range: [low, high] in rad above the horizontal, within +-pi/2.
        reachable_by: An action term that moves a tool. Both radii are made smaller by one factor,
            until the tool reaches 19 of 20 places within the action's bounds.

    Example:
        ``{func: randomize_object_position_in_shell, mode: reset, params: {of: {uid: goal}, relative_to: {uid: ur10}, radius_range: [0.4, 1.1]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        relative_to: Body,
        radius_range: Range,
        azimuth_range: Range = (-3.141592653589793, 3.141592653589793),
        elevation_range: Range = (-_RIGHT_ANGLE, _RIGHT_ANGLE),
        reachable_by: str | None = None,
    ) -> None:
        problems: list[Problem] = []
        if entity_cfg.is_articulation:
            problems.append(Problem("entity_cfg.uid", f"{entity_cfg.uid!r} is not a rigid object"))
        if radius_range[0] < 0:
            message = f"must not be negative, got {list(radius_range)}"
            problems.append(Problem("radius_range", message))
        if max(map(abs, elevation_range)) > _RIGHT_ANGLE + 1e-9:
            message = f"is within +-pi/2, got {list(elevation_range)}"
            problems.append(Problem("elevation_range", message))
        if problems:
            raise ConfigError(problems)
        self._asset = entity_cfg.rigid_object
        self._centre = relative_to
        low, high = (
            [radius_range[i] ** 3, azimuth_range[i], np.sin(elevation_range[i])] for i in (0, 1)
        )
        self._shell = Uniform("shell", low, high)
        self._reachable_by = reachable_by
        self.fitted: dict[str, Any] = {}
        self._quat = _rows_of(self._asset.index.quat0, env)
        self._stop = None if self._asset.is_non_dynamic else self._asset.stop

    def prepare(self, env: TermContext) -> None:
        """Make the shell smaller until an arm reaches it, once."""
        name = self._reachable_by
        if name is None:
            return
        origin, _ = initial_pose_of(env, self._centre.frame)
        # A spiral on each of both spheres, and on one between them.
        count = 3 * _SPIRAL
        part = (np.arange(count) + 0.5) / count
        ends = np.stack([self._shell.low, self._shell.high])
        radius = np.cbrt(ends[:, 0])[np.array([0, 1, 1])].copy()
        radius[2] = 0.5 * (radius[0] + radius[1])
        turns = _GOLDEN * np.arange(count) % 1.0
        azimuth = ends[0, 1] + turns * (ends[1, 1] - ends[0, 1])
        sine = ends[0, 2] + part * (ends[1, 2] - ends[0, 2])
        flat = np.sqrt(1.0 - sine * sine)
        directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), sine], axis=1)
        offsets = np.tile(radius, _SPIRAL)[:, None] * directions
        share = fitted_share(env, name, origin, offsets)
        self.fitted["reachable_by"] = None if share == 1.0 else share
        if share < 1.0:
            _log.info("%s: places are drawn in to %g of the range", name, share)
            factors = np.array([share**3, 1.0, 1.0])
            self._shell = Uniform("shell", ends[0] * factors, ends[1] * factors)
        self._reachable_by = None

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the positions of these environments."""
        self.prepare(env)  # a term that replaces another one is not prepared yet
        drawn = self._shell(env.event_manager, env_ids)
        # Contiguous columns: numpy may round a strided transcendental function differently.
        radius_cubed, azimuth, sine = (contiguous(drawn[:, i]) for i in range(3))
        radius = np.cbrt(radius_cubed)
        flat = radius * np.sqrt(np.maximum(0.0, 1.0 - sine * sine))
        offset = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), radius * sine], axis=1)
        origin = self._centre.position()
        if env_ids is not None:
            origin = origin[env_ids]
        pos = origin + offset
        self._asset.write_pose(pos, self._quat[: len(pos)], env_ids)
        if self._stop is not None:
            self._stop(env_ids)


@register_term("event", name="randomize_robot_eef_pose")
class RandomizeRobotEefPose(Term):
    """Offsets the pose of a robot's tool at random, by inverse kinematics; velocities become 0.

    The tool's pose is moved by U(position_range) in the environment's axes and rotated by
    U(rotation_range) in its own; inverse kinematics solve for joints near their positions, and drive
    targets are set to them. Where the pose is out of reach, joints do not change.
    EmbodiChain's event of the same name.

    Args:
        entity_cfg: The robot; control parts or joint names pick the joints that move, a link, site
            or geom is the tool (else it is the link farthest from the base that they move).
        position_range: [[x, y, z] low, [x, y, z] high] in metres; None keeps the position.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ; None keeps the
            orientation.

    Example:
        ``{func: randomize_robot_eef_pose, mode: reset, params: {of: {uid: ur10, link_names: [ee_link]}, position_range: [[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]], rotation_range: [[-10, -10, -10], [10, 10, 10]]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Arm,
        position_range: Box3 | None = None,
        rotation_range: Box3 | None = None,
    ) -> None:
        env.arrays.require_host("searches for joint positions")
        self._asset = entity_cfg.articulation
        self._arm = arm_solver(entity_cfg)
        self._position = Uniform.within("position", position_range)
        self._rotation = Uniform.within("rotation", rotation_range, degrees=True)
        index = self._asset.index
        self._dofs = np.asarray(index.dof_adr, np.int64)
        self._driven = np.flatnonzero(np.asarray(index.actuator_ids) >= 0)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw, solve and write the joint positions of these environments."""
        asset = self._asset
        engine = asset.engine
        tool = self._arm.chain.tool
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        pos = tool.positions(engine)[ids]
        quat = tool.orientations(engine)[ids]
        if self._position is not None:
            pos = pos + self._position(env.event_manager, env_ids)
        if self._rotation is not None:
            angles = self._rotation(env.event_manager, env_ids)
            quat = quat_multiply(quat, euler_xyz_to_quat(angles))
        qpos = asset.read_qpos()[ids]
        solution, is_solved = self._arm.inverse(qpos, pos, quat, ids, restarts=False)
        qpos = np.where(is_solved[:, None], solution, qpos)
        asset.write_qpos(qpos, None, env_ids)
        engine.write("qvel", 0.0, env_ids, self._dofs)
        if len(self._driven):
            asset.write_target(qpos[:, self._driven], self._driven, env_ids)
