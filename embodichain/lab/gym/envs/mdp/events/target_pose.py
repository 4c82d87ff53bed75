"""Events that draw target poses which are no entities: matrices kept on the environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Box3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.lab.gym.envs.mdp._stored import stored
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, pose_to_matrix, quat_multiply

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = ["RandomizeTargetPose"]


@register_term("event", name="randomize_target_pose")
class RandomizeTargetPose(Term):
    """Draws a target pose and keeps it as ``env.<store_key>``, (N, 4, 4) float32 matrices.

    Terms such as `distance_to_target` read it there. EmbodiChain's event of the same name. Until
    the first draw the pose is the identity.

    Args:
        position_range: [[x, y, z] low, [x, y, z] high] in metres.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ (R = Rx Ry Rz);
            None keeps the orientation of the reference (no rotation without one).
        relative_position: True adds the draw to the reference's position, where it stands at that
            moment; False takes it as the position in the environment's frame.
        relative_rotation: True turns the reference's orientation by the draw, in its own frame.
        reference_entity_cfg: An entity, or a link of one; what is relative needs it.
        store_key: The attribute of the environment.

    Example:
        ``{func: randomize_target_pose, mode: reset, params: {position_range: [[0.3, -0.3, 0.5], [0.7, 0.3, 0.9]], store_key: target_pose}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        position_range: Box3,
        rotation_range: Box3 | None = None,
        relative_position: bool = False,
        relative_rotation: bool = False,
        reference_entity_cfg: ResolvedEntity | None = None,
        store_key: str = "target_pose",
    ) -> None:
        for name, wants in (
            ("relative_position", relative_position),
            ("relative_rotation", relative_rotation),
        ):
            if wants and reference_entity_cfg is None:
                message = "needs reference_entity_cfg: relative to what?"
                raise ConfigError([Problem(name, message)])
        self._env, self._key = env, store_key
        self._reference = reference_entity_cfg
        self._moves, self._turns = relative_position, relative_rotation
        self._box = constant(position_range[0]), constant(position_range[1])
        self._angles: tuple[F64, F64] | None = None
        if rotation_range is not None:
            low, high = (np.deg2rad(np.asarray(row, np.float64)) for row in rotation_range)
            self._angles = constant(low), constant(high)
        count = env.num_envs
        stored(env, store_key, lambda: torch.eye(4).repeat(count, 1, 1), "store_key")

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw the target poses of these environments."""
        where: Any = slice(None) if env_ids is None else env_ids
        pos = env.event_manager.draw("position", (3,), *self._box, env_ids)
        quat: F64 = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (len(pos), 1))
        if self._reference is not None:
            at, turned = _pose(self._reference)
            pos = at[where] + pos if self._moves else pos
            quat = turned[where]
        if self._angles is not None:
            angles = env.event_manager.draw("rotation", (3,), *self._angles, env_ids)
            turn = euler_xyz_to_quat(angles)
            quat = quat_multiply(quat, turn) if self._turns else turn
        matrices = pose_to_matrix(np.concatenate([pos, quat], axis=1))
        # A new tensor: whoever kept the old one keeps what it was.
        poses: torch.Tensor = getattr(env, self._key).clone()
        poses[where] = torch.from_numpy(matrices.astype(np.float32))
        setattr(env, self._key, poses)

    def state_dict(self) -> dict[str, Any]:
        """The poses (a copy)."""
        return {"poses": getattr(self._env, self._key).clone()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        setattr(self._env, self._key, state["poses"].clone())


def _pose(entity: ResolvedEntity) -> tuple[F64, F64]:
    """Position (N, 3) and orientation (N, 4) of the picked link, else of the root."""
    if entity.link_body is None:
        found: tuple[F64, F64] = entity.asset.read_pose()
        return found
    engine, body = entity.asset.engine, entity.link_body
    return engine.derived("xpos")[:, body], engine.derived("xquat")[:, body]
