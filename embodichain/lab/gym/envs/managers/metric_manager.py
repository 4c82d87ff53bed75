"""`MetricManager`: quantities reduced over an episode; they end nothing.

Any term with a reward's signature can be a metric.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import MetricCfg
from embodichain.lab.gym.envs.managers.base import Manager, checked_rows

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = ["MetricManager"]

_REDUCE: dict[str, tuple[Callable[[Any, Any], Any], bool | float]] = {
    "last": (lambda so_far, value: value, 0.0),
    "any": (np.logical_or, False),
    "all": (np.logical_and, True),
    "sum": (np.add, 0.0),
    "mean": (np.add, 0.0),
    "max": (np.maximum, float("-inf")),
    "min": (np.minimum, float("inf")),
}
"""What joins the value so far with the next one, and the first value."""


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
        # Arrays (N,), replaced and never written to: those handed out stay as they are.
        self._so_far: dict[str, NDArray[Any]] = {
            name: np.full(self.num_envs, start, dtype)
            for name, _, dtype, _, start, _ in self._calls
        }
        self._count: NDArray[np.float32] = np.zeros(self.num_envs, np.float32)

    def _bind(self) -> None:
        self._checked = False
        # `success` first: other metrics may read it.
        ordered = sorted(self.terms.items(), key=lambda item: item[0] != "success")
        self._calls = []
        for name, term in ordered:
            join, start = _REDUCE[term.cfg.reduce]
            dtype = np.bool_ if isinstance(start, bool) else np.float32
            mean = term.cfg.reduce == "mean"
            self._calls.append((name, term.call, dtype, join, start, mean))

    @property
    def has_success(self) -> bool:
        """Whether the metric ``success`` exists."""
        return "success" in self.terms

    def compute(self, obs: Any, action: Any, info: dict[str, Any]) -> NDArray[np.bool_] | None:
        """Evaluate every term of this step.

        Args:
            obs: The step's observation.
            action: The step's action.
            info: ``metrics`` in it gains name -> (N,), this step included, which does not change
                afterwards; entries of the environment's class remain.

        Returns:
            (N,) bool, the metric ``success``; None if there is none.

        Raises:
            ValueError: If a term's value has another shape than (N,); names the term.
        """
        metrics: dict[str, torch.Tensor] = dict(info.get("metrics", {}))
        info["metrics"] = metrics
        if not self._calls:
            return None
        self._count = self._count + np.float32(1.0)
        success: NDArray[np.bool_] | None = None
        for name, call, dtype, join, _, mean in self._calls:
            value = call(self.env, obs, action, info)
            if not self._checked:
                checked_rows(value, self.num_envs, "metric", name)
            array = value if type(value) is np.ndarray else value.numpy(force=True)
            so_far = self._so_far[name] = join(self._so_far[name], array.astype(dtype))
            shown = so_far / self._count if mean else so_far.copy()
            metrics[name] = torch.from_numpy(shown)
            if name == "success":
                success = shown.astype(np.bool_)
        self._checked = True
        return success

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Start these environments' episodes anew."""
        super().reset(env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        self._count = self._count.copy()
        self._count[where] = 0.0
        for name, _, _, _, start, _ in self._calls:
            so_far = self._so_far[name] = self._so_far[name].copy()
            so_far[where] = start

    def state_dict(self) -> dict[str, Any]:
        """Values so far, and the state of terms that are classes (copies)."""
        so_far = {name: values.copy() for name, values in self._so_far.items()}
        return {**super().state_dict(), "count": self._count.copy(), "kept": so_far}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self._count = state["count"].copy()
        self._so_far = {name: values.copy() for name, values in state["kept"].items()}
