"""Events that push bodies for a while: forces with a beginning and an end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.lab.gym.envs.mdp.events.pushes import ApplyExternalForceTorque
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["ApplyBodyImpulse"]


@register_term("event", name="apply_body_impulse")
class ApplyBodyImpulse(ApplyExternalForceTorque):
    """Pushes bodies with a random force and torque for a random time, then rests, and so on.

    Give it `mode: interval` and `interval_step: 1`: it then looks at its clock in every control
    step. An episode begins with a rest; times are rounded to control steps, at least one. mjlab's
    event of the same name. Of two terms that push the same body only one has effect.

    Args:
        entity_cfg: A dynamic object, or a robot; its link names pick links, else it is the root.
        force_range: [low, high] in N, a component each, environment's axes, at the centre of mass.
        torque_range: [low, high] in N m, likewise.
        duration_s: [low, high] seconds of a push.
        cooldown_s: [low, high] seconds of a rest.

    Example:
        ``{func: apply_body_impulse, mode: interval, interval_step: 1, params: {entity_cfg: {uid: go}, force_range: [-30, 30], torque_range: [0, 0], duration_s: [0.1, 0.2], cooldown_s: [1, 3]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        force_range: Range,
        torque_range: Range,
        duration_s: Range,
        cooldown_s: Range,
    ) -> None:
        super().__init__(env, entity_cfg, force_range, torque_range)
        for name, bounds in (("duration_s", duration_s), ("cooldown_s", cooldown_s)):
            if not bounds[0] > 0:
                raise ConfigError([Problem(name, f"needs 0 < low, got {list(bounds)}")])
        self._times: dict[str, tuple[F64, F64]] = {
            "duration": (constant([duration_s[0]]), constant([duration_s[1]])),
            "cooldown": (constant([cooldown_s[0]]), constant([cooldown_s[1]])),
        }
        self._until: NDArray[np.int64] = np.zeros(env.num_envs, np.int64)
        """Control step of the episode that ends the push or the rest; 0 is not drawn yet."""
        self._pushes: NDArray[np.bool_] = np.zeros(env.num_envs, np.bool_)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin with a rest; a reset of the scene has removed the forces."""
        where: Any = slice(None) if env_ids is None else env_ids
        self._until[where] = 0
        self._pushes[where] = False

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Begin and end what is due in these environments."""
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        step = env.elapsed_steps.numpy().astype(np.int64) + 1  # this one is not counted yet
        self._wait(env, ids[self._until[ids] == 0], step * 0, "cooldown")
        due = ids[step[ids] >= self._until[ids]]
        ends, begins = due[self._pushes[due]], due[~self._pushes[due]]
        if len(ends):
            self._engine.write("xfrc_applied", 0.0, ends, self._columns)
            self._wait(env, ends, step, "cooldown")
        if len(begins):
            super().__call__(env, begins)
            self._wait(env, begins, step, "duration")
        self._pushes[due] = ~self._pushes[due]

    def _wait(self, env: TermContext, ids: EnvIndex, since: NDArray[np.int64], what: str) -> None:
        if len(ids):
            seconds = env.event_manager.draw(what, (1,), *self._times[what], ids)[:, 0]
            steps = np.maximum(1, np.rint(seconds / env.step_dt)).astype(np.int64)
            self._until[ids] = since[ids] + steps

    def state_dict(self) -> dict[str, Any]:
        """Who is being pushed, and until when."""
        return {"until": self._until.copy(), "pushes": self._pushes.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._until[:] = state["until"]
        self._pushes[:] = state["pushes"]
