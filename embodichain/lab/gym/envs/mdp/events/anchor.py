"""Events that raise and lower a table with everything that stands on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import lazy_loader
import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Finite, Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.lab.gym.envs.mdp._stored import stored
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = ["RandomizeAnchorHeight"]


@register_term("event", name="randomize_anchor_height")
class RandomizeAnchorHeight(Term):
    """Raises an anchor (a table) by a random height, and every dynamic object with it.

    The anchor's height is its initial one plus the draw; dynamic objects move by as much as the
    anchor does. EmbodiChain's event of the same name; there are no object groups here, and so no
    `include_groups`.

    Args:
        anchor_uid: A rigid object, or a robot or articulation.
        height_delta_range: [low, high] in metres, uniform; or
        height_delta_candidates: heights in metres, one of which is picked with equal chances.
        exclude_uids: Dynamic objects that stay.
        store_key: If given, ``env.<store_key>`` holds the heights drawn, (N,) float32 metres.

    Example:
        ``{func: randomize_anchor_height, mode: reset, params: {anchor_uid: goal, height_delta_range: [-0.05, 0.05], exclude_uids: [cube]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        anchor_uid: str,
        height_delta_range: Range | None = None,
        height_delta_candidates: Annotated[list[Finite], Field(min_length=1)] | None = None,
        exclude_uids: list[str] | None = None,
        store_key: str | None = None,
    ) -> None:
        if (height_delta_range is None) == (height_delta_candidates is None):
            message = "give either height_delta_range or height_delta_candidates"
            raise ConfigError([Problem("height_delta_range", message)])
        self._env, self._key = env, store_key
        self._anchor = _asset(env, anchor_uid, "anchor_uid")
        excluded = {anchor_uid}
        for number, uid in enumerate(exclude_uids or ()):
            excluded.add(_asset(env, uid, f"exclude_uids.{number}").uid)
        self._carried = [
            handle
            for uid, handle in env.sim.rigid_objects.items()
            if not handle.is_non_dynamic and uid not in excluded
        ]
        self._candidates: F64 | None = None
        bounds: Any = height_delta_range
        if height_delta_candidates is not None:
            self._candidates = np.asarray(height_delta_candidates, np.float64)
            bounds = 0.0, float(len(self._candidates))
        self._low, self._high = constant([bounds[0]]), constant([bounds[1]])
        self._delta: F64 = np.zeros(env.num_envs)
        if store_key is not None:
            count = env.num_envs
            stored(env, store_key, lambda: torch.zeros(count), "store_key")

    def reset(self, env_ids: EnvIndex | None) -> None:
        """A reset has put everything back to its configured height."""
        self._delta[slice(None) if env_ids is None else env_ids] = 0.0

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw heights and move the anchor and what it carries in these environments."""
        where: Any = slice(None) if env_ids is None else env_ids
        height = env.event_manager.draw("height", (1,), self._low, self._high, env_ids)[:, 0]
        if self._candidates is not None:
            height = self._candidates[height.astype(np.int64)]
        pos = self._anchor.read_pose()[0][where].copy()
        pos[:, 2] = float(self._anchor.entity.pos0[2]) + height
        self._anchor.write_pose(pos, None, env_ids)
        for handle in self._carried:
            pos = handle.read_pose()[0][where].copy()
            pos[:, 2] += height - self._delta[where]
            handle.write_pose(pos, None, env_ids)
        self._delta[where] = height
        self._publish()

    def _publish(self) -> None:
        if self._key is not None:
            setattr(self._env, self._key, torch.from_numpy(self._delta.astype(np.float32)))

    def state_dict(self) -> dict[str, Any]:
        """How high everything stands now."""
        return {"delta": self._delta.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._delta[:] = state["delta"]
        self._publish()


def _asset(env: TermContext, uid: str, path: str) -> Any:
    sim = env.sim
    assets: dict[str, Any] = {**sim.robots, **sim.articulations, **sim.rigid_objects}
    if uid not in assets:
        message = f"no entity is called {uid!r}; there are: {', '.join(assets) or 'none'}"
        raise ConfigError([Problem(path, message, did_you_mean(uid, assets).strip())])
    return assets[uid]
