"""Events that place whole entities: objects, and roots of robots."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Box3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, quat_multiply

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["RandomizeArticulationRootPose", "RandomizeRigidObjectPose"]

Steps = Annotated[int, Field(ge=-1)]


@register_term("event", name="randomize_rigid_object_pose")
class RandomizeRigidObjectPose(Term):
    """Places a rigid object at random and stops it.

    The pose is the object's declared initial pose, moved by uniform draws. EmbodiChain's event of
    the same name; `relative_to` is added.

    Args:
        entity_cfg: The object.
        position_range: [[x, y, z] low, [x, y, z] high] in metres; None draws no position.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ (R = Rx Ry Rz);
            None keeps the initial orientation.
        relative_position: True adds the draw to the initial position (or to `relative_to`), False
            takes it as the position in the environment's frame.
        relative_rotation: True turns the initial orientation by the draw, in the object's own
            frame; False takes it as the orientation.
        relative_to: An entity, or a link of one, that the draw is added to instead, where it stands
            at that moment; its orientation does not matter.
        physics_update_step: Physics steps that these environments take afterwards, so that what
            was placed can touch down; -1 or 0 takes none.

    Example:
        ``{func: randomize_rigid_object_pose, mode: reset, params: {entity_cfg: {uid: cube}, position_range: [[-0.1, -0.1, 0], [0.1, 0.1, 0]], rotation_range: [[0, 0, -180], [0, 0, 180]]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        position_range: Box3 | None = None,
        rotation_range: Box3 | None = None,
        relative_position: bool = True,
        relative_rotation: bool = False,
        relative_to: ResolvedEntity | None = None,
        physics_update_step: Steps = -1,
    ) -> None:
        self._asset = asset = entity_cfg.asset
        self._stop = self._stopper(entity_cfg)
        self._steps = physics_update_step
        if relative_to is not None and not relative_position:
            message = "relative_to needs relative_position: true"
            raise ConfigError([Problem("relative_position", message)])
        index = asset.entity
        count = env.num_envs
        base = np.asarray(index.pos0, np.float64)
        self._pos0: F64 = np.tile(base, (count, 1))
        self._quat0: F64 = np.tile(np.asarray(index.quat0, np.float64), (count, 1))
        self._near = relative_to
        self._box: tuple[F64, F64] | None = None
        if position_range is not None:
            low, high = (np.asarray(row, np.float64) for row in position_range)
            shift = base if relative_position and relative_to is None else 0.0
            self._box = (constant(low + shift), constant(high + shift))
        self._turn: tuple[F64, F64] | None = None
        if rotation_range is not None:
            low, high = (np.deg2rad(np.asarray(row, np.float64)) for row in rotation_range)
            self._turn = (constant(low), constant(high))
        self._relative_rotation = relative_rotation

    def _stopper(self, entity: ResolvedEntity) -> Callable[[EnvIndex | None], None] | None:
        """What stops the entity, None if it cannot move by itself; refuses the wrong kind."""
        asset = entity.asset
        if not hasattr(asset, "is_non_dynamic"):
            message = f"{entity.uid!r} is not a rigid object"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        stop: Callable[[EnvIndex | None], None] = asset.stop
        return None if asset.is_non_dynamic else stop

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the poses of these environments."""
        quat0 = self._quat0 if env_ids is None else self._quat0[: len(env_ids)]
        quat: F64 | None = quat0
        if self._turn is None and self._stand_already(quat0, env_ids):
            quat = None
        if self._box is not None:
            pos = env.event_manager.draw("position", (3,), *self._box, env_ids)
        else:
            pos = self._pos0[: len(quat0)]
        if self._near is not None:
            origin = self._near.position()
            pos = (origin if env_ids is None else origin[env_ids]) + (
                0.0 if self._box is None else pos
            )
        if self._turn is not None:
            angles = env.event_manager.draw("rotation", (3,), *self._turn, env_ids)
            turn = euler_xyz_to_quat(angles)
            quat = quat_multiply(quat0, turn) if self._relative_rotation else turn
        self._asset.write_pose(pos, quat, env_ids)
        if self._stop is not None:
            self._stop(env_ids)
        if self._steps > 0:
            self._asset.engine.step(self._steps, env_ids)

    def _stand_already(self, wanted: F64, env_ids: EnvIndex | None) -> bool:
        """Whether orientations need no write, which a log would keep."""
        if self._stop is not None or not self._asset.engine.listeners:
            return False
        now = self._asset.read_pose()[1]
        return bool(((now if env_ids is None else now[env_ids]) == wanted).all())


@register_term("event", name="randomize_articulation_root_pose")
class RandomizeArticulationRootPose(RandomizeRigidObjectPose):
    """Places the root of a robot or another articulation at random; its joints stop moving.

    As `randomize_rigid_object_pose`, for articulations: joint positions stay. EmbodiChain's event
    of the same name.

    Args:
        entity_cfg: The robot or articulation.
        position_range: [[x, y, z] low, [x, y, z] high] in metres; None draws no position.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ (R = Rx Ry Rz).
        relative_position: True adds the draw to the initial position (or to `relative_to`), False
            takes it as the position in the environment's frame.
        relative_rotation: True turns the initial orientation by the draw, in the root's own frame;
            False takes it as the orientation.
        relative_to: An entity, or a link of one, that the draw is added to instead.
        physics_update_step: Physics steps that these environments take afterwards.

    Example:
        ``{func: randomize_articulation_root_pose, mode: reset, params: {entity_cfg: {uid: ur10}, position_range: [[-0.05, -0.05, 0], [0.05, 0.05, 0]]}}``
    """  # noqa: E501  (an example is one line)

    def _stopper(self, entity: ResolvedEntity) -> Callable[[EnvIndex | None], None] | None:
        if not hasattr(entity.asset, "parsed"):
            message = f"{entity.uid!r} is not a robot or articulation"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        stop: Callable[[EnvIndex | None], None] = entity.asset.clear_dynamics
        return stop
