"""`MetricManager`: quantities reduced over an episode; they end nothing.

Any term with a reward's signature can be a metric.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader

from embodichain.lab.gym.envs.cfg import MetricCfg
from embodichain.lab.gym.envs.managers.base import Manager, checked_rows

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = ["MetricManager"]

_JOIN: dict[str, Callable[[Any, Any], Any]] = {
    "last": lambda kept, value: value,
    "any": lambda kept, value: kept | value,
    "all": lambda kept, value: kept & value,
    "sum": lambda kept, value: kept + value,
    "mean": lambda kept, value: kept + value,
    "max": lambda kept, value: torch.maximum(kept, value),
    "min": lambda kept, value: torch.minimum(kept, value),
}
_START: dict[str, bool | float] = {
    "last": 0.0,
    "any": False,
    "all": True,
    "sum": 0.0,
    "mean": 0.0,
    "max": float("-inf"),
    "min": float("inf"),
}


class MetricManager(Manager[MetricCfg]):
    """Reduces every metric over the episode so far.

    The values are float32, or bool where `reduce` is ``any`` or ``all``. The metric called
    ``success`` is the task's success; it is evaluated before the others.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> metric.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, MetricCfg]) -> None:
        super().__init__(env, "metrics", "metric", cfgs)
        self._kept: dict[str, torch.Tensor] = {}
        self._count: torch.Tensor | None = None
        if self._calls:
            self._kept = {n: torch.full((self.num_envs,), _START[r]) for n, _, r in self._calls}
            self._count = torch.zeros(self.num_envs)
        self._checked = False

    def _bind(self) -> None:
        # `success` first: other metrics may ask for it.
        ordered = sorted(self.terms.items(), key=lambda item: item[0] != "success")
        self._calls = [(name, t.call, t.cfg.reduce) for name, t in ordered]

    @property
    def has_success(self) -> bool:
        """Whether the metric ``success`` exists."""
        return "success" in self.terms

    def compute(self, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor | None:
        """Take this step's values in.

        Args:
            obs: The step's observation.
            action: The step's action.
            info: ``metrics`` in it gains name -> (N,), this step included, left alone afterwards;
                what the environment's class put there stays.

        Returns:
            (N,) bool, the metric ``success``; None if there is none.

        Raises:
            ValueError: If a term's value has another shape than (N,); names the term.
        """
        metrics: dict[str, torch.Tensor] = dict(info.get("metrics", {}))
        info["metrics"] = metrics
        if self._count is None:
            return None
        self._count = self._count + 1.0
        for name, call, reduce in self._calls:
            value = call(self.env, obs, action, info)
            if not self._checked:
                checked_rows(value, self.num_envs, "metric", name)
            if reduce in ("any", "all"):
                value = value if value.dtype == torch.bool else value != 0
            elif value.dtype != torch.float32:
                value = value.to(torch.float32)
            kept = self._kept[name] = _JOIN[reduce](self._kept[name], value)
            metrics[name] = kept / self._count if reduce == "mean" else kept.clone()
        self._checked = True
        success = metrics.get("success") if self.has_success else None
        if success is None or success.dtype == torch.bool:
            return success
        return success != 0

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Start these environments' episodes anew; what `info` holds is left alone."""
        super().reset(env_ids)
        if self._count is None:
            return
        where: Any = slice(None) if env_ids is None else env_ids
        self._count = self._count.clone()
        self._count[where] = 0.0
        for name, _, reduce in self._calls:
            kept = self._kept[name] = self._kept[name].clone()
            kept[where] = _START[reduce]

    def state_dict(self) -> dict[str, Any]:
        """Values so far, and the state of terms that are classes (copies)."""
        state = super().state_dict()
        if self._count is not None:
            state["count"] = self._count.clone()
            state["kept"] = {name: kept.clone() for name, kept in self._kept.items()}
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        if self._count is not None:
            self._count = state["count"].clone()
            self._kept = {name: kept.clone() for name, kept in state["kept"].items()}
