"""The event that places whole entities: objects, and roots of robots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.drawing import Uniform
from embodichain.lab.gym.envs.managers.param_types import Box3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, quat_multiply

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["RandomizePose"]


@register_term("event", name="randomize_pose")
class RandomizePose(Term):
    """Places an object, or the root of a robot or articulation, at random and stops it.

    The pose is the declared initial pose, moved by uniform draws. Joint positions stay.

    Args:
        entity_cfg: The object, robot or articulation.
        position_range: [[x, y, z] low, [x, y, z] high] in metres; None draws no position.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ (R = Rx Ry Rz);
            None keeps the initial orientation.
        relative_position: True adds the draw to the initial position (or to `relative_to`), False
            takes it as the position in the environment's frame.
        relative_rotation: True turns the initial orientation by the draw, in the entity's own
            frame; False takes it as the orientation.
        relative_to: An entity, or a link of one, to whose present position the draw is added
            instead; its orientation does not matter.
        physics_update_step: Physics steps that these environments take afterwards, so that what
            was placed can touch down; -1 or 0 takes none.

    Example:
        ``{func: randomize_pose, mode: reset, params: {entity_cfg: {uid: cube}, position_range: [[-0.1, -0.1, 0], [0.1, 0.1, 0]], rotation_range: [[0, 0, -180], [0, 0, 180]]}}``
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
        physics_update_step: Annotated[int, Field(ge=-1)] = -1,
    ) -> None:
        self._asset = asset = entity_cfg.asset
        if hasattr(asset, "parsed"):
            self._stop = asset.clear_dynamics
        else:
            self._stop = None if asset.is_non_dynamic else asset.stop
        self._steps = physics_update_step
        if relative_to is not None and not relative_position:
            message = "relative_to needs relative_position: true"
            raise ConfigError([Problem("relative_position", message)])
        base = np.asarray(asset.entity.pos0, np.float64)
        self._pos0: F64 = np.tile(base, (env.num_envs, 1))
        self._quat0: F64 = np.tile(np.asarray(asset.entity.quat0, np.float64), (env.num_envs, 1))
        self._near = relative_to
        self._position: Uniform | None = None
        if position_range is not None:
            shift = base if relative_position and relative_to is None else 0.0
            self._position = Uniform("position", *(np.asarray(b) + shift for b in position_range))
        self._rotation = Uniform.within("rotation", rotation_range, degrees=True)
        self._relative_rotation = relative_rotation

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the poses of these environments."""
        quat0 = self._quat0 if env_ids is None else self._quat0[: len(env_ids)]
        quat: F64 | None = quat0
        if self._rotation is None and self._is_turned_so(quat0, env_ids):
            quat = None
        pos = self._pos0[: len(quat0)]
        if self._position is not None:
            pos = self._position(env.event_manager, env_ids)
        if self._near is not None:
            origin = self._near.position()
            origin = origin if env_ids is None else origin[env_ids]
            pos = origin + (0.0 if self._position is None else pos)
        if self._rotation is not None:
            turn = euler_xyz_to_quat(self._rotation(env.event_manager, env_ids))
            quat = quat_multiply(quat0, turn) if self._relative_rotation else turn
        self._asset.write_pose(pos, quat, env_ids)
        if self._stop is not None:
            self._stop(env_ids)
        if self._steps > 0:
            self._asset.engine.step(self._steps, env_ids)

    def _is_turned_so(self, wanted: F64, env_ids: EnvIndex | None) -> bool:
        """Whether orientations need no write, which a log would contain."""
        if self._stop is not None or not self._asset.engine.listeners:
            return False
        now = self._asset.read_pose()[1]
        return bool(((now if env_ids is None else now[env_ids]) == wanted).all())
