"""`ObservationManager`: adds declared entries to the observation, and flattens groups of them.

The terms themselves are in `envs/mdp/observations.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.gym.envs.managers.base import BuiltTerm, Manager
from embodichain.lab.gym.utils.tensordicts import put
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.types import EnvObs
else:
    torch = lazy_loader.load("torch")

__all__ = ["ObservationManager"]


class ObservationManager(Manager[ObservationCfg]):
    """Runs observation terms in declared order.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> observation.
    """

    def __init__(self, env: BaseEnv, cfgs: Mapping[str, ObservationCfg]) -> None:
        super().__init__(env, "observations", "observation", cfgs)
        self._entries = [_Entry(term, self.num_envs) for term in self.terms.values()]
        self._groups: dict[str, dict[tuple[str, ...], None]] = {}
        for entry in self._entries:
            # A term that modifies an entry declares it as well; each stands once.
            self._groups.setdefault(entry.term.cfg.group, {})[entry.path] = None

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups, in order of appearance."""
        return tuple(self._groups)

    def group_terms(self, group: str = "policy") -> tuple[str, ...]:
        """Names of a group's entries ("/" nests) in the order of the flattened vector.

        Raises:
            ValueError: If no term is in the group; lists the groups.
        """
        return tuple("/".join(path) for path in self._paths(group))

    def _paths(self, group: str) -> dict[tuple[str, ...], None]:
        try:
            return self._groups[group]
        except KeyError:
            known = ", ".join(self._groups) or "none"
            raise ValueError(
                f"no observation is in group {group!r}; there are: {known}."
                f"{did_you_mean(group, self._groups)}"
            ) from None

    def compute(self, obs: EnvObs) -> EnvObs:
        """Add or modify the declared entries.

        Args:
            obs: What is observed already; entries are set in it.

        Returns:
            The same object.

        Raises:
            ValueError: If a term's value is not a tensor (N, ...); names the term.
        """
        for entry in self._entries:
            entry.compute(self.env, obs)
        return obs

    def flatten(self, obs: EnvObs, group: str = "policy") -> torch.Tensor:
        """Concatenate a group's entries in declared order.

        Args:
            obs: An observation of the environment.
            group: The group.

        Returns:
            (N, K) float32.

        Raises:
            ValueError: If no term is in the group; lists the groups.
        """
        count = self.num_envs
        parts = [obs[path].reshape(count, -1).to(torch.float32) for path in self._paths(group)]
        return torch.cat(parts, dim=1)


class _Entry:
    """One term's place in the observation and what is done to its value."""

    def __init__(self, term: BuiltTerm[ObservationCfg], num_envs: int) -> None:
        cfg = term.cfg
        self.term = term
        self.path = tuple((cfg.name or term.name).split("/"))
        self._num_envs = num_envs
        self._modify = cfg.mode == "modify"
        self._clip = cfg.clip
        self._scale: float | torch.Tensor | None = None
        if cfg.scale is not None:
            scale = cfg.scale
            self._scale = scale if isinstance(scale, (int, float)) else torch.tensor(scale)
        self._shape: torch.Size | None = None

    def compute(self, env: BaseEnv, obs: EnvObs) -> None:
        if self._modify and self._shape is None:
            self._find(obs)
        value = self.term.call(env, obs[self.path] if self._modify else obs)
        if self._shape is None:
            self._check(value)
        if self._clip is not None:
            value = value.clamp(self._clip[0], self._clip[1])
        if self._scale is not None:
            value = value * self._scale
        if value.dtype == torch.float64:
            value = value.to(torch.float32)
        if value.device == obs.device:
            put(obs, self.path, value)
        else:
            obs.set(self.path, value)

    def _find(self, obs: EnvObs) -> None:
        known = [k if isinstance(k, str) else "/".join(k) for k in obs.keys(True, True)]
        wanted = "/".join(self.path)
        if wanted not in known:
            raise ConfigError(
                [
                    Problem(
                        f"observations.{self.term.name}.name",
                        f"nothing to modify is called {wanted!r}; before it: {', '.join(known)}",
                        did_you_mean(wanted, known).strip(),
                    )
                ]
            )

    def _check(self, value: Any) -> None:
        name, want = self.term.name, f"a tensor of shape ({self._num_envs}, ...)"
        if not isinstance(value, torch.Tensor):
            raise ValueError(
                f"observation term {name!r} must return {want}, got {type(value).__name__}"
            )
        if value.ndim == 0 or value.shape[0] != self._num_envs:
            raise ValueError(
                f"observation term {name!r} must return {want}, got {tuple(value.shape)}"
            )
        if isinstance(self._scale, torch.Tensor) and self._scale.shape != value.shape[-1:]:
            raise ValueError(
                f"observation term {name!r}: scale has {len(self._scale)} values, "
                f"its last dimension {tuple(value.shape)}"
            )
        self._shape = value.shape
