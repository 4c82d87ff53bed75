"""Events that wait for objects to come to rest, and that detach entities from resets."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Annotated, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Positive, Whole
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._rows import norm
from embodichain.lab.gym.envs.mdp.events.placing import read_root_velocity
from embodichain.utils.errors import ConfigError, EmbodichainError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.objects.rigid_object import RigidObject
    from embodichain.utils.array_types import EnvIds, Floats

__all__ = ["NotAtRestError", "WaitForDynamicObjectsToSettle", "set_detached_uids_for_env_reset"]

logger = logging.getLogger(__name__)

Count = Annotated[int, Field(ge=1)]


class NotAtRestError(EmbodichainError, TimeoutError):
    """Objects did not come to rest in time."""


@register_term("event")
def set_detached_uids_for_env_reset(
    env: TermContext, env_ids: EnvIds | None, uids: list[str]
) -> None:
    """Excludes entities from later resets: EmbodiChain's event of the same name.

    Args:
        env: The environment.
        env_ids: Unused: the event applies to all environments.
        uids: The entities.

    Raises:
        ValueError: If an entity does not exist; lists those that do.

    Example:
        ``{func: set_detached_uids_for_env_reset, mode: startup, params: {uids: [goal]}}``
    """
    env.add_detached_uids_for_reset(uids)


@register_term("event", name="wait_for_dynamic_objects_to_settle")
class WaitForDynamicObjectsToSettle(Term):
    """Steps physics until dynamic objects are at rest, separately in each environment.

    An environment is at rest when the speeds of all objects were at most the thresholds in
    `required_stable_checks` consecutive checks. Environments at rest, and those outside of this
    event, are not stepped. The step counts of episodes do not advance. EmbodiChain's event of the
    same name, which steps all environments and therefore needs `allow_partial_envs`.

    Args:
        entity_cfgs: Dynamic objects, or articulations (the speeds of their links count); None is
            all except robots.
        linear_velocity_threshold: m/s.
        angular_velocity_threshold: rad/s.
        min_steps: Physics steps before the first check.
        max_steps: Largest number of physics steps.
        check_interval_steps: Physics steps between checks.
        required_stable_checks: Number of consecutive checks.
        timeout_behavior: If an environment does not come to rest, `warn` logs a warning, `raise`
            raises `TimeoutError`.
        allow_partial_envs: Accepted; partial resets always work here.

    Example:
        ``{func: wait_for_dynamic_objects_to_settle, mode: reset, params: {entity_cfgs: [{uid: cube}], max_steps: 120}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfgs: list[Whole] | None = None,
        linear_velocity_threshold: Positive = 0.03,
        angular_velocity_threshold: Positive = 0.2,
        min_steps: Annotated[int, Field(ge=0)] = 10,
        max_steps: Count = 240,
        check_interval_steps: Count = 2,
        required_stable_checks: Count = 3,
        timeout_behavior: Literal["warn", "raise"] = "warn",
        allow_partial_envs: bool = True,
    ) -> None:
        env.arrays.require_host("physics steps of some environments")
        if entity_cfgs is None:
            objects = [o for o in env.sim.rigid_objects.values() if not o.is_non_dynamic]
            self._assets: list[Articulation | RigidObject] = [
                *objects,
                *env.sim.articulations.values(),
            ]
        else:
            self._assets = [_need_dynamic(entity, i) for i, entity in enumerate(entity_cfgs)]
        if not self._assets:
            message = "there is nothing to wait for: no dynamic object and no articulation"
            raise ConfigError([Problem("entity_cfgs", message)])
        if max_steps < min_steps:
            message = f"is less than min_steps, {min_steps}: got {max_steps}"
            raise ConfigError([Problem("max_steps", message)])
        self._linear_threshold = linear_velocity_threshold
        self._angular_threshold = angular_velocity_threshold
        self._min_steps = min_steps
        self._max_steps = max_steps
        self._check_interval = check_interval_steps
        self._required_checks = required_stable_checks
        self._raises = timeout_behavior == "raise"

    def __call__(self, env: TermContext, env_ids: EnvIds | None) -> None:
        """Step these environments until they are at rest."""
        engine = env.sim.engine
        ids: EnvIds = np.arange(env.num_envs) if env_ids is None else env_ids
        stable_checks: NDArray[np.int64] = np.zeros(len(ids), np.int64)
        steps = self._min_steps
        if steps:
            engine.step(steps, ids)
        while True:
            stable_checks = np.where(self._are_slow()[ids], stable_checks + 1, 0)
            is_moving = stable_checks < self._required_checks
            ids = ids[is_moving]
            stable_checks = stable_checks[is_moving]
            if not len(ids) or steps >= self._max_steps:
                break
            next_steps = min(self._check_interval, self._max_steps - steps)
            engine.step(next_steps, ids)
            steps += next_steps
        if len(ids):
            self._report_motion(ids)

    def _report_motion(self, ids: EnvIds) -> None:
        """Raise an error or log a warning for environments that do not come to rest."""
        names = ", ".join(asset.uid for asset in self._assets)
        shown_ids = f"{ids[:8].tolist()}{'...' if len(ids) > 8 else ''}"
        message = (
            f"{names} did not come to rest within {self._max_steps} physics steps in environments "
            f"{shown_ids}"
        )
        if self._raises:
            raise NotAtRestError(message)
        logger.warning(message)

    def _are_slow(self) -> NDArray[np.bool_]:
        """(N,) whether every object is slow enough now."""
        all_slow: NDArray[np.bool_] | None = None
        for asset in self._assets:
            for velocity in _velocities(asset):
                is_slow = norm(velocity[:, :3]) <= self._linear_threshold
                is_slow &= norm(velocity[:, 3:]) <= self._angular_threshold
                all_slow = is_slow if all_slow is None else all_slow & is_slow
        if all_slow is None:
            raise RuntimeError("an articulation without links cannot be waited for")
        return all_slow


def _need_dynamic(entity: ResolvedEntity, number: int) -> Articulation | RigidObject:
    """Return the handle of an entity that can come to rest.

    Raises:
        ConfigError: If it never moves by itself.
    """
    if getattr(entity.asset, "is_non_dynamic", False):
        message = f"{entity.uid!r} is not dynamic: it never moves by itself"
        raise ConfigError([Problem(f"entity_cfgs.{number}.uid", message)])
    return entity.asset


def _velocities(asset: Articulation | RigidObject) -> list[Floats]:
    """(N, 6) linear and angular velocities, of the object or of each link."""
    if not hasattr(asset, "parsed"):
        return [read_root_velocity(asset)]
    articulation = cast("Articulation", asset)
    return [articulation.velocity_of(int(body)) for body in articulation.index.body_ids]
