"""Events that place objects between two spheres: within reach of an arm, in any direction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.drawing import Uniform
from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["RandomizeObjectPositionInShell"]

_RIGHT_ANGLE = 1.5707963267948966


@register_term("event", name="randomize_object_position_in_shell")
class RandomizeObjectPositionInShell(Term):
    """Places a rigid object between two spheres around an entity, uniformly in volume; stops it.

    With u uniform: r = cbrt(U(r0^3, r1^3)), azimuth = U, sin(elevation) = U(sin e0, sin e1). The
    object keeps its initial orientation.

    Args:
        entity_cfg: The object.
        relative_to: The entity, or link of one, at the centre, where it stands at that moment.
        radius_range: [low, high] in metres.
        azimuth_range: [low, high] in rad about z, from +x towards +y.
        elevation_range: [low, high] in rad above the horizontal, within +-pi/2.

    Example:
        ``{func: randomize_object_position_in_shell, mode: reset, params: {entity_cfg: {uid: goal}, relative_to: {uid: ur10}, radius_range: [0.4, 1.1]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        relative_to: ResolvedEntity,
        radius_range: Range,
        azimuth_range: Range = (-3.141592653589793, 3.141592653589793),
        elevation_range: Range = (-_RIGHT_ANGLE, _RIGHT_ANGLE),
    ) -> None:
        problems = []
        if not hasattr(entity_cfg.asset, "is_non_dynamic"):
            problems.append(Problem("entity_cfg.uid", f"{entity_cfg.uid!r} is not a rigid object"))
        if radius_range[0] < 0:
            problems.append(
                Problem("radius_range", f"must not be negative, got {list(radius_range)}")
            )
        if max(map(abs, elevation_range)) > _RIGHT_ANGLE + 1e-9:
            problems.append(
                Problem("elevation_range", f"is within +-pi/2, got {list(elevation_range)}")
            )
        if problems:
            raise ConfigError(problems)
        self._asset = entity_cfg.asset
        self._centre = relative_to
        bounds = [
            [radius_range[i] ** 3, azimuth_range[i], np.sin(elevation_range[i])] for i in (0, 1)
        ]
        self._shell = Uniform("shell", *bounds)
        quat = np.asarray(self._asset.entity.quat0, np.float64)
        self._quat: F64 = np.tile(quat, (env.num_envs, 1))
        self._stop = None if self._asset.is_non_dynamic else self._asset.stop

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the positions of these environments."""
        drawn = self._shell(env.event_manager, env_ids)
        # Contiguous columns: numpy may round a strided transcendental function differently.
        radius, azimuth, rise = (np.ascontiguousarray(drawn[:, i]) for i in range(3))
        radius = np.cbrt(radius)
        flat = radius * np.sqrt(np.maximum(0.0, 1.0 - rise * rise))
        offset = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), radius * rise], axis=1)
        origin = self._centre.position()
        pos = (origin if env_ids is None else origin[env_ids]) + offset
        self._asset.write_pose(pos, self._quat[: len(pos)], env_ids)
        if self._stop is not None:
            self._stop(env_ids)
