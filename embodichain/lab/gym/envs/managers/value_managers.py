"""Managers of terms with one number per environment: rewards, terminations and metrics.

`TermRows` are their values by name; `check_values` calls each once when an environment is built.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg, TerminationCfg
from embodichain.lab.gym.envs.managers.manager import Manager, checked_rows
from embodichain.lab.gym.envs.managers.terms.check import check_weight
from embodichain.lab.gym.envs.managers.terms.term_errors import FAILURES, kind_of_values
from embodichain.utils.arrays import is_host, tensor_of
from embodichain.utils.errors import ConfigError
from embodichain.utils.named import Named, unknown_name

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.types import EnvObs

__all__ = [
    "MetricManager",
    "RewardManager",
    "TermRows",
    "TerminationManager",
    "check_shapes",
    "check_values",
]


class TermRows(Mapping[str, "torch.Tensor"]):
    """Values of terms in N environments: name of a term -> (N,) tensor, a copy of its row.

    Args:
        names: Names of the T terms.
        rows: (T, N), or T arrays (N,); never written to afterwards.

    Attributes:
        names: Names of the terms.
        rows: Values of the terms; writing to returned tensors does not change them.
    """

    __slots__ = ("_tensors", "names", "rows")

    def __init__(self, names: Sequence[str], rows: Any = ()) -> None:
        self.names = names
        self.rows = rows
        self._tensors: dict[str, torch.Tensor] = {}

    def __getitem__(self, name: str) -> torch.Tensor:
        """Return a term's values; the same tensor at every call, on a device a new one."""
        if name in self._tensors:
            return self._tensors[name]
        try:
            row = self.rows[self.names.index(name)]
        except ValueError:
            raise unknown_name("term", name, self.names) from None
        tensor = tensor_of(row.copy())
        if is_host(row):  # a captured step (`StepGraph`) writes new values into its rows
            self._tensors[name] = tensor
        return tensor

    def arrays(self) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield name and values (N,) of each term: do not write to them."""
        return zip(self.names, self.rows, strict=True)

    def zeroed(self, mask: NDArray[np.bool_]) -> TermRows:
        """Return the values with those of some environments, (N,) bool, set to 0."""
        if isinstance(self.rows, (list, tuple)):
            zeroed_rows = [np.where(mask, row.dtype.type(0), row) for row in self.rows]
            return TermRows(self.names, zeroed_rows)
        return TermRows(self.names, np.where(mask, np.float32(0.0), self.rows))

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self.names)

    def __len__(self) -> int:
        """Return the number of terms."""
        return len(self.names)

    def __repr__(self) -> str:
        """Return names and values."""
        return f"TermRows({dict(self)})"


Masks = dict[str, NDArray[np.bool_]]
_BOOL = np.dtype(np.bool_)


class TerminationManager(Manager[TerminationCfg]):
    """Joins the terms of each kind by "or".

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> termination.

    Attributes:
        values: Name -> (N,) bool of the last step; empty before the first.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, TerminationCfg]) -> None:
        super().__init__(env, "terminations", "termination", cfgs)
        self._names = tuple(self.terms)
        self.values = TermRows(())

    def _bind(self) -> None:
        self._checked = False
        self._calls = [(name, term.call, term.cfg.ends_by) for name, term in self.terms.items()]

    @property
    def has_success(self) -> bool:
        """Whether a term of kind ``success`` exists."""
        return any(kind == "success" for _, _, kind in self._calls)

    def compute(self, obs: Any, action: Any, info: dict[str, Any] | None) -> Masks:
        """Evaluate every term of this step.

        Args:
            obs: The step's observation.
            action: The step's action.
            info: The entries of `evaluate`, and ``elapsed_steps``; None if no term reads them.

        Returns:
            (N,) bool masks by kind, ``success``, ``fail``, ``time_out``; kinds without a term are
            absent. ``success`` and ``fail`` terminate, ``time_out`` truncates.

        Raises:
            ConfigError: If a term's value has another shape than (N,); names the term.
        """
        masks: Masks = {}
        if not self._calls:
            return masks
        values: list[NDArray[np.bool_]] = []
        for name, call, kind in self._calls:
            try:
                value = call(self.env, obs, action, info)
                if not self._checked:
                    checked_rows(value, self.num_envs, "termination", name)
                if type(value) is not np.ndarray:
                    value = self._arrays.of(value)
            except FAILURES as error:
                self.fail(name, error)
            if value.dtype != _BOOL:
                self._warn_not_finite(name, value, "which counts as true")
            flags = value.astype(np.bool_)  # a copy: the term may reuse its array
            values.append(flags)
            masks[kind] = masks[kind] | flags if kind in masks else flags
        self._checked = True
        self.values = TermRows(self._names, values)
        return masks


@dataclass(frozen=True, slots=True)
class _Reduction:
    """How a metric reduces the values of an episode.

    Attributes:
        join: The function of the value so far and the next one.
        start: The value before the first one.
    """

    join: Callable[[Any, Any], Any]
    start: bool | float


_REDUCTIONS = {
    "last": _Reduction(join=lambda so_far, value: value, start=0.0),
    "any": _Reduction(join=np.logical_or, start=False),
    "all": _Reduction(join=np.logical_and, start=True),
    "sum": _Reduction(join=np.add, start=0.0),
    "mean": _Reduction(join=np.add, start=0.0),  # divided by the count where it is read
    "max": _Reduction(join=np.maximum, start=float("-inf")),
    "min": _Reduction(join=np.minimum, start=float("inf")),
}
"""The reductions, by the name that `reduce` gives."""


@dataclass(frozen=True, slots=True)
class _MetricCall:
    """A metric as it is evaluated in a step.

    Attributes:
        name: Its name.
        call: The term.
        join: As of `_Reduction`, with `start`.
        start: The value before the first one.
        dtype: The type of its values.
        is_mean: Whether the sum so far is divided by the number of steps.
    """

    name: str
    call: Callable[..., Any]
    join: Callable[[Any, Any], Any]
    start: bool | float
    dtype: type[np.bool_] | type[np.float32]
    is_mean: bool


class MetricManager(Manager[MetricCfg]):
    """Reduces every metric over the episode so far.

    The values are float32, or bool where `reduce` is ``any`` or ``all``. The metric called
    ``success`` is the task's success where it is above 0; it is evaluated before the others.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> metric.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, MetricCfg]) -> None:
        super().__init__(env, "metrics", "metric", cfgs)
        # Arrays (N,), replaced and never written to: returned ones must not change.
        self._so_far: dict[str, NDArray[Any]] = {
            metric.name: env.arrays.full(self.num_envs, metric.start, metric.dtype)
            for metric in self._calls
        }
        self._count: NDArray[np.float32] = env.arrays.full(self.num_envs, 0.0, np.float32)
        self._one_step: NDArray[np.float32] = env.arrays.full(self.num_envs, 1.0, np.float32)

    def _bind(self) -> None:
        self._checked = False
        # `success` first: other metrics may read it.
        ordered = sorted(self.terms.items(), key=lambda item: item[0] != "success")
        self._calls: list[_MetricCall] = []
        for name, term in ordered:
            reduction = _REDUCTIONS[term.cfg.reduce]
            metric = _MetricCall(
                name=name,
                call=term.call,
                join=reduction.join,
                start=reduction.start,
                dtype=np.bool_ if isinstance(reduction.start, bool) else np.float32,
                is_mean=term.cfg.reduce == "mean",
            )
            self._calls.append(metric)

    @property
    def has_success(self) -> bool:
        """Whether the metric ``success`` exists."""
        return "success" in self.terms

    def compute(
        self, obs: Any, action: Any, info: dict[str, Any] | None
    ) -> dict[str, NDArray[Any]]:
        """Evaluate every term of this step.

        Args:
            obs: The step's observation.
            action: The step's action.
            info: What terms read, or None if none does. Entries name -> (N,), this step included,
                are added to ``metrics`` in it, and do not change afterwards; entries of the
                environment's class remain. The metric ``success``, declared or of the class,
                replaces ``success`` in it, (N,) bool.

        Returns:
            The declared metrics: name -> (N,), this step included. They do not change afterwards:
            do not write to them.

        Raises:
            ConfigError: If a term's value has another shape than (N,); names the term.
        """
        if info is not None:
            info["metrics"] = dict(info.get("metrics", {}))
            if "success" in info["metrics"] and not self.has_success:
                info["success"] = tensor_of(self._arrays.of(info["metrics"]["success"]) > 0)
        values: dict[str, NDArray[Any]] = {}
        if not self._calls:
            return values
        self._count = self._count + self._one_step
        for metric in self._calls:
            name = metric.name
            try:
                value = metric.call(self.env, obs, action, info)
                if not self._checked:
                    checked_rows(value, self.num_envs, "metric", name)
                if type(value) is not np.ndarray:
                    value = self._arrays.of(value)
            except FAILURES as error:
                self.fail(name, error)
            if value.dtype != _BOOL:
                self._warn_not_finite(name, value, "the metric keeps it")
            so_far = metric.join(self._so_far[name], value.astype(metric.dtype))
            self._so_far[name] = so_far
            reduced = so_far / self._count if metric.is_mean else so_far
            values[name] = reduced
            if info is not None:
                info["metrics"][name] = tensor_of(reduced.copy())
                if name == "success":  # before the other metrics, which may read it
                    info["success"] = tensor_of(reduced > 0)
        self._checked = True
        return values

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Restart the episodes of these environments."""
        super().reset(env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        self._count = self._count.copy()
        self._count[where] = 0.0
        for metric in self._calls:
            so_far = self._so_far[metric.name].copy()
            so_far[where] = metric.start
            self._so_far[metric.name] = so_far

    def state_dict(self) -> dict[str, Any]:
        """Values so far, and the state of terms that are classes (copies)."""
        so_far = {name: values.copy() for name, values in self._so_far.items()}
        return {**super().state_dict(), "count": self._count.copy(), "kept": so_far}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self._count = state["count"].copy()
        self._so_far = {name: values.copy() for name, values in state["kept"].items()}


F32 = NDArray[np.float32]


class RewardManager(Manager[RewardCfg]):
    """Sums value x weight over the terms, without x dt.

    A term of weight 0 is not evaluated; its value is 0 everywhere. When its weight becomes another
    one it begins without a state, as at the start of an episode.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> reward.
        floor: Smallest sum of a step, the rewards of hooks included; None means no limit.

    Attributes:
        weights: Name -> current weight; replaced, not changed, by `set_weight`.
        values: Name -> (N,) float32 value of the last step, without weights.
    """

    def __init__(
        self, env: TermContext, cfgs: Mapping[str, RewardCfg], floor: float | None = None
    ) -> None:
        self._floor = None if floor is None else np.float32(floor)
        weights = {name: float(cfg.weight) for name, cfg in cfgs.items()}
        self.weights: Mapping[str, float] = MappingProxyType(Named("reward", weights))
        super().__init__(env, "rewards", "reward", cfgs)
        # Arrays (T, N), replaced and never written to: returned ones must not change.
        self._sums: F32 = env.arrays.full((len(self.terms), self.num_envs), 0.0, np.float32)
        self._sums_before = self._sums
        # Copied in every step, which is quicker than `np.zeros_like`. Row 0 of the summands is the
        # reward of hooks, the others are value x weight of the terms.
        self._no_values: F32 = env.arrays.full((len(self.terms), self.num_envs), 0.0, np.float32)
        self._no_summands: F32 = env.arrays.full(
            (len(self.terms) + 1, self.num_envs), 0.0, np.float32
        )
        self._names = tuple(self.terms)
        self.values = TermRows(())

    def _bind(self) -> None:
        self._checked = False
        # Row in the arrays of values, name and call of each term that counts.
        self._calls: list[tuple[int, str, Callable[..., Any]]] = []
        # The first row of the sum, in which row 0 is the reward of the hooks.
        self._first_summand = 0
        for row, (name, term) in enumerate(self.terms.items()):
            if self.weights[name] != 0.0:
                self._calls.append((row, name, term.call))
            if term.cfg.mode == "replace":
                self._first_summand = row + 1
        weights = [self.weights[name] for name in self.terms]
        self._factors: F32 = np.array(weights, np.float32)[:, None]

    @property
    def episode_sums(self) -> TermRows:
        """Name -> (N,) float32 sum of value x weight since the episode began (copies)."""
        return TermRows(self._names, self._sums)

    def set_weight(self, name: str, weight: float) -> None:
        """Change the weight of a term from the next step on.

        Raises:
            ConfigError: If it is not finite.
        """
        problems = check_weight(f"rewards.{name}.weight", weight)
        if problems:
            raise ConfigError(problems)
        before = self.weights[name]
        if before == weight:
            return
        weights = {**self.weights, name: float(weight)}
        self.weights = MappingProxyType(Named("reward", weights))
        self.revision += 1
        if before == 0.0:
            self._renew(name)
        self._bind()

    def compute(
        self, rewards: F32 | None, obs: Any, action: Any, info: dict[str, Any] | None
    ) -> F32:
        """Evaluate every term of this step.

        Args:
            rewards: (N,) from hooks of the environment, or None; terms are added to it, and one
                with ``mode: replace`` replaces the sum before it.
            obs: The step's observation.
            action: The step's action.
            info: What terms read, or None if none does. ``rewards`` (values without weights) and
                ``episode_sums`` (with weights, this step included) are set in it, and do not
                change afterwards.

        Returns:
            (N,) float32.

        Raises:
            ConfigError: If a term's value has another shape than (N,); names the term.
        """
        if not self.terms:
            if info is not None:
                info["rewards"] = {}
                info["episode_sums"] = {}
            if rewards is not None:
                return rewards
            return self._arrays.full(self.num_envs, 0.0, np.float32)
        env = self.env
        values = self._no_values.copy()  # a term of weight 0 is not evaluated
        for row, name, call in self._calls:
            try:
                value = call(env, obs, action, info)
                if not self._checked:
                    checked_rows(value, self.num_envs, "reward", name)
                values[row] = value if type(value) is np.ndarray else self._arrays.of(value)
            except FAILURES as error:
                self.fail(name, error)
        self._checked = True
        summands = self._no_summands.copy()
        if rewards is not None:
            summands[0] = rewards
        weighted = np.multiply(values, self._factors, out=summands[1:])
        self._sums_before = self._sums
        self._sums = self._sums + weighted
        # Row by row: the rounding does not depend on the number of environments.
        total: F32 = np.add.accumulate(summands[self._first_summand :], axis=0)[-1]
        self.values = TermRows(self._names, values)
        if info is not None:
            info["rewards"] = self.values
            info["episode_sums"] = self.episode_sums
        if self._floor is None:
            return total
        # A sum that is not finite stays so: it is a mistake, which a floor must not hide.
        return np.where(total > -np.inf, np.maximum(total, self._floor), total)

    def not_finite(self, rows: NDArray[np.bool_]) -> dict[str, tuple[str, NDArray[np.bool_]]]:
        """Return the terms whose last value, or value x weight, is not finite in environments.

        Args:
            rows: (N,) the environments.

        Returns:
            ``rewards.NAME`` -> what its values are, and in which environments, (N,).
        """
        causes: dict[str, tuple[str, NDArray[np.bool_]]] = {}
        for name, row, factor in zip(self._names, self.values.rows, self._factors, strict=True):
            weighted = row * factor
            bad = rows & ~np.isfinite(weighted)
            if bad.any():
                causes[f"{self.section}.{name}"] = (kind_of_values(weighted[bad]), bad)
        return causes

    def take_back(self, rows: NDArray[np.bool_]) -> None:
        """Undo the last step in the sums of environments, (N,) bool."""
        self._sums = np.where(rows, self._sums_before, self._sums)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Set the sums of these environments to 0."""
        super().reset(env_ids)
        self._sums = self._sums.copy()
        self._sums[:, slice(None) if env_ids is None else env_ids] = 0.0

    def state_dict(self) -> dict[str, Any]:
        """Sums and weights, and the state of terms that are classes (copies)."""
        return {
            **super().state_dict(),
            "weights": dict(self.weights),
            "episode_sums": dict(zip(self._names, self._sums.copy(), strict=True)),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self.weights = MappingProxyType(Named("reward", state["weights"]))
        self.revision += 1
        self._bind()
        self._sums = np.empty_like(self._sums)
        for row, name in enumerate(self._names):
            self._sums[row] = state["episode_sums"][name]


def check_values(env: TermContext, obs: EnvObs) -> None:
    """Call every termination, metric and reward once to check its shape, and undo the changes.

    Random streams are restored and terms are reset. Only for environments with the default
    `evaluate`: another one may put entries into ``info`` that terms need, and may need a reset
    first; for these the first step checks shapes.

    Args:
        env: The environment, complete.
        obs: An observation of it.

    Raises:
        ConfigError: If a term's value has another shape than (N,); names the term.
    """
    terminations = cast("TerminationManager", env.managers["terminations"])
    metrics = cast("MetricManager", env.managers["metrics"])
    rewards = cast("RewardManager", env.managers["rewards"])
    managers = (terminations, metrics, rewards)
    if not any(len(manager) for manager in managers):
        return
    no_flags = tensor_of(env.arrays.full(env.num_envs, False, np.bool_))
    info: dict[str, Any] = {
        "elapsed_steps": env.elapsed_steps,
        "success": no_flags,
        "success_terminated": no_flags.clone(),
        "fail": no_flags.clone(),
    }
    action = env.last_action
    streams = env.streams.state_dict()
    terminations.compute(obs, action, info)
    metrics.compute(obs, action, info)
    rewards.compute(None, obs, action, info)
    env.streams.load_state_dict(streams)
    for manager in managers:
        manager.reset(None)


check_shapes = check_values
"""The older name."""
