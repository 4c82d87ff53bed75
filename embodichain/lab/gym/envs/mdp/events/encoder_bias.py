"""The event that draws the errors of joints' encoders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Range, Whole
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex

__all__ = ["EncoderBias"]


@register_term("event", name="encoder_bias", takes_strength=True)
class EncoderBias(Term):
    """Draws the error of each joint's encoder, in each environment: U(bias_range).

    It stays until it is drawn again. ``{func: joint_position, params: {biased: true}}`` observes
    positions with it, and the position targets of `joint_action` are for such positions: the joint
    goes to the target minus the error, except with ``centre: qpos`` or ``target``. Rewards and
    physics know no error. A state that is restored from a log has the errors of its episode with
    ``mode: reset`` only. mjlab's event of the same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        bias_range: [low, high] in rad or m.

    Example:
        ``{func: encoder_bias, mode: startup, params: {of: {uid: go}, bias_range: [-0.015, 0.015]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: Whole, bias_range: Range) -> None:
        if not entity_cfg.joint_ids:
            raise ConfigError([Problem("entity_cfg.uid", f"{entity_cfg.uid!r} has no joints")])
        self._asset = entity_cfg.articulation
        self._joints: NDArray[np.int64] = np.asarray(entity_cfg.joint_ids, np.int64)
        count = len(self._joints)
        self._bias = Uniform(
            "bias", np.full(count, bias_range[0]), np.full(count, bias_range[1]), default=0.0
        )

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw the errors of these environments' encoders."""
        where: Any = slice(None) if env_ids is None else env_ids[:, None]
        bias = self._bias(env.event_manager, env_ids)
        self._asset.drives.encoder_bias[where, self._joints] = bias
