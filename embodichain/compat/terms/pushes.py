"""EmbodiChain's push with an interval among its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.managers.param_types import Axes6, Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp.events.pushes import EpisodeTimer, PushBySettingVelocity

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex

__all__ = ["PushArticulation"]


@register_term("event", name="push_articulation_by_setting_velocity")
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
        ``{func: push_articulation_by_setting_velocity, mode: interval, interval_step: 1, params: {entity_cfg: {uid: go}, interval_range_s: [5, 10], velocity_range: {x: [-0.5, 0.5]}}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        interval_range_s: Range,
        velocity_range: Axes6,
    ) -> None:
        super().__init__(env, entity_cfg, velocity_range)
        self._interval = EpisodeTimer.seconds("interval", "interval_range_s", interval_range_s)
        self._timer = EpisodeTimer(env)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Draw a new time where an episode begins."""
        self._timer.reset(env_ids)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Push the environments whose time has come."""
        self._timer.start(self._interval, self._timer.stopped(env_ids))
        due = self._timer.advance(env_ids)
        if len(due):
            super().__call__(env, due)
            self._timer.start(self._interval, due)

    def state_dict(self) -> dict[str, Any]:
        """When the next pushes come."""
        return self._timer.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._timer.load_state_dict(state)
