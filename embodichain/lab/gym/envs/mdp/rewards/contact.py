"""Rewards of contacts: which links may touch, how hard, how long feet stay in the air, and slide.

All read a contact sensor declared under `sensors:`, whose forces are those of the last physics
step. Values are positive: penalties want negative weights. Formulas are Isaac Lab's
(`isaaclab.envs.mdp.rewards` and its velocity task), which take the largest force of several
physics steps where these take the last one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import NonNegative
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.mdp import _sensors, _spatial
from embodichain.lab.gym.envs.mdp._commands import columns
from embodichain.lab.gym.envs.mdp._judge import Judge, any_column, total
from embodichain.utils.math import cross

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["ContactForces", "DesiredContacts", "FeetAirTime", "FeetSlide", "UndesiredContacts"]


class _Contacts(Judge, _sensors.ReadsContact):
    """Knows which links are touched by more than a force."""

    def __init__(self, env: TermContext, sensor: str, threshold: float) -> None:
        self._sensor, self._threshold = _sensors.contact(env, sensor), threshold

    def touched(self) -> NDArray[np.bool_]:
        """(N, n) whether the net force on each link is longer than the threshold."""
        return _sensors.magnitude(self._sensor.read_force()) > self._threshold


@register_term("reward", "metric", name="undesired_contacts")
class UndesiredContacts(_Contacts):
    """How many links of a sensor are touched by more than a force. Isaac Lab's of the same name.

    Args:
        sensor: A contact sensor on the links that should not touch anything.
        threshold: N.

    Example:
        ``{func: undesired_contacts, weight: -1.0, params: {sensor: contacts, threshold: 1.0}}``
    """

    def __init__(self, env: TermContext, sensor: str, threshold: NonNegative = 1.0) -> None:
        super().__init__(env, sensor, threshold)

    def value(self) -> F64:
        """(N,) links."""
        return total(self.touched().astype(np.float64))


@register_term("reward", "metric", name="desired_contacts")
class DesiredContacts(_Contacts):
    """1 where no link of a sensor is touched by more than a force, else 0: a penalty for jumping.

    Isaac Lab's reward of the same name.

    Args:
        sensor: A contact sensor on the links of which one at least should touch.
        threshold: N.

    Example:
        ``{func: desired_contacts, weight: -1.0, params: {sensor: contacts, threshold: 1.0}}``
    """

    def __init__(self, env: TermContext, sensor: str, threshold: NonNegative = 1.0) -> None:
        super().__init__(env, sensor, threshold)

    def value(self) -> F64:
        """(N,) 0 or 1."""
        return np.where(any_column(self.touched()), 0.0, 1.0)


@register_term("reward", "metric", name="contact_forces")
class ContactForces(Judge, _sensors.ReadsContact):
    """Sum over links of max(|f| - threshold, 0), N: touching too hard. Isaac Lab's of the name.

    Args:
        sensor: A contact sensor.
        threshold: N, the net force on a link that costs nothing.

    Example:
        ``{func: contact_forces, weight: -0.001, params: {sensor: contacts, threshold: 100.0}}``
    """

    def __init__(self, env: TermContext, sensor: str, threshold: NonNegative) -> None:
        self._sensor, self._threshold = _sensors.contact(env, sensor), threshold

    def value(self) -> F64:
        """(N,) N."""
        excess = _sensors.magnitude(self._sensor.read_force()) - self._threshold
        return total(np.maximum(excess, 0.0))


@register_term("reward", "metric", name="feet_air_time")
class FeetAirTime(_Contacts):
    """Sum over feet that land in this step of (time in the air - threshold), s: longer steps pay.

    0 where the command asks for less than `min_command`. Air time counts control steps, the one of
    the landing included; feet that an episode begins in the air count from its first step. Isaac
    Lab's reward of the same name.

    Args:
        sensor: A contact sensor on the feet.
        command_name: A command whose first two columns are vx and vy, m/s; None always pays.
        threshold: s in the air that earns nothing; shorter steps cost.
        min_command: m/s.
        force_threshold: N above which a foot touches.

    Example:
        ``{func: feet_air_time, weight: 0.5, params: {sensor: contacts, command_name: velocity, threshold: 0.5}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        sensor: str,
        command_name: str | None = None,
        threshold: NonNegative = 0.5,
        min_command: NonNegative = 0.1,
        force_threshold: NonNegative = 1.0,
    ) -> None:
        super().__init__(env, sensor, force_threshold)
        self._least, self._min_command, self._dt = threshold, min_command, env.step_dt
        self._command: Callable[[], F64] | None = None
        if command_name is not None:
            self._command = columns(env, command_name, 2)
        self._air: F64 = np.zeros((env.num_envs, len(self._sensor.names)))

    def value(self) -> F64:
        """(N,) s; the feet's clocks go on by one control step."""
        touched = self.touched()
        lasted = self._air + self._dt
        landed = touched & (self._air > 0.0)
        self._air = np.where(touched, 0.0, lasted)
        paid = total(np.where(landed, lasted - self._least, 0.0))
        if self._command is None:
            return paid
        moving = _spatial.norm(self._command()[:, :2]) > self._min_command
        return np.where(moving, paid, 0.0)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Set the clocks of these environments to 0."""
        self._air[slice(None) if env_ids is None else env_ids] = 0.0

    def state_dict(self) -> dict[str, Any]:
        """The clocks (a copy)."""
        return {"air": self._air.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._air = state["air"].copy()


@register_term("reward", "metric", name="feet_slide")
class FeetSlide(_Contacts):
    """Sum over touched feet of their speed in the plane, m/s. Isaac Lab's reward of the same name.

    The speed is that of each link's origin.

    Args:
        sensor: A contact sensor on the feet.
        threshold: N above which a foot touches.

    Example:
        ``{func: feet_slide, weight: -0.1, params: {sensor: contacts}}``
    """

    def __init__(self, env: TermContext, sensor: str, threshold: NonNegative = 1.0) -> None:
        super().__init__(env, sensor, threshold)
        self._engine = env.sim.engine
        self._bodies = self._sensor.body_ids
        self._roots = self._engine.model.body_rootid[self._bodies].astype(np.int64)

    def value(self) -> F64:
        """(N,) m/s."""
        engine = self._engine
        # cvel is (angular, linear) at the centre of mass of the kinematic tree.
        cvel = engine.derived("cvel")[:, self._bodies]
        arm = engine.derived("xpos")[:, self._bodies]
        arm = arm - engine.derived("subtree_com")[:, self._roots]
        linear = cvel[..., 3:] + cross(cvel[..., :3], arm)
        x, y = linear[..., 0], linear[..., 1]
        return total(np.where(self.touched(), np.sqrt(x * x + y * y), 0.0))
