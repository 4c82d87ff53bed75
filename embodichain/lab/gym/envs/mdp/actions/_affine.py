"""`Affine`: value = centre + scale x clamp(action, clip), one column a joint or an actuator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.mdp.actions._per_joint import joint_clip, per_joint
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.base import F64

__all__ = ["Affine"]


class Affine:
    """The values of an action, in float64, and the bounds that follow.

    Args:
        names: What the A columns move.
        scale: `PerJoint`, not 0; names that a map leaves out get 1.
        offset: `PerJoint`; names that a map leaves out get 0.
        clip: `JointClip`, or None: the bounds of the action then follow from `limits`.
        centre: (A,) added to the offset.
        limits: Low and high of the value, (A,) each, finite: needed without `clip`.
        what: What a name is, for messages.

    Attributes:
        low, high: (A,) float32 bounds of the action; unset with neither `clip` nor `limits`.
    """

    def __init__(
        self,
        names: Sequence[str],
        scale: Any,
        offset: Any,
        clip: Any,
        centre: F64 | float = 0.0,
        limits: tuple[Any, Any] | None = None,
        what: str = "joint",
    ) -> None:
        self._scale: F64 = per_joint(scale, names, "scale", 1.0, what)
        if (self._scale == 0).any():
            raise ConfigError([Problem("scale", "must not be 0")])
        self._centre: F64 = per_joint(offset, names, "offset", 0.0, what) + centre
        self._clips = clip is not None
        if clip is not None:
            self._least, self._most = joint_clip(clip, names, "clip", what)
        elif limits is not None:
            ends = (np.asarray(limits, np.float64) - self._centre) / self._scale
            self._least, self._most = np.minimum(*ends), np.maximum(*ends)
        self.low: NDArray[np.float32] = self._least.astype(np.float32)
        self.high: NDArray[np.float32] = self._most.astype(np.float32)
        self._plain = bool((self._scale == 1).all() and not self._centre.any())

    def value(self, action: torch.Tensor) -> F64:
        """(N, A) the value of an action."""
        given: F64 = action.numpy()
        if self._clips:
            given = np.minimum(np.maximum(given, self.low), self.high)  # float32: no conversion
        return given if self._plain else self._centre + self._scale * given

    def action_for(self, value: F64 | float) -> F64:
        """(A,) or (N, A) the action that gives a value, as far as the bounds allow."""
        found: F64 = np.clip((value - self._centre) / self._scale, self._least, self._most)
        return found
