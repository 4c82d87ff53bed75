"""`ObservationManager`: adds declared entries to the observation, and flattens groups of them.

What is done to a term's value is in `observation_entry.py`; the terms themselves are in
`envs/mdp/observations`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.gym.envs.managers.base import Manager
from embodichain.lab.gym.envs.managers.observation_entry import ObservationEntry
from embodichain.lab.gym.envs.managers.past import Rows
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex
    from embodichain.lab.sim.types import EnvObs
else:
    torch = lazy_loader.load("torch")

__all__ = ["ObservationManager"]

_NOBODY: NDArray[np.int64] = np.zeros(0, np.int64)
_LOOKING = Rows(_NOBODY, None)


class ObservationManager(Manager[ObservationCfg]):
    """Runs observation terms in declared order.

    Noise is drawn, and delays and histories move on, once for each environment that stepped or was
    reset: the environment says who by setting `stepped` before it observes. Whoever calls `compute`
    besides only looks, and changes nothing.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> observation.

    Attributes:
        stepped: (n,) environments that the next `compute` is for, or None for all.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, ObservationCfg]) -> None:
        self._entries: list[ObservationEntry] = []
        super().__init__(env, "observations", "observation", cfgs)
        corrupted = env.cfg.enable_corruption
        for term in self.terms.values():
            noisy = (
                corrupted if isinstance(corrupted, bool) else corrupted.get(term.cfg.group, True)
            )
            self._entries.append(ObservationEntry(env, term, noisy))
        self._groups: dict[str, dict[tuple[str, ...], None]] = {}
        for entry in self._entries:
            # A term that modifies an entry declares it as well; each stands once.
            self._groups.setdefault(entry.term.cfg.group, {})[entry.path] = None
        self._remembers = any(entry.remembers for entry in self._entries)
        self._fresh: NDArray[np.bool_] = np.ones(env.num_envs, np.bool_)
        self.stepped: EnvIndex | None = _NOBODY

    def _bind(self) -> None:
        for entry in self._entries:
            entry.term = self.terms[entry.term.name]

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
        rows = self._rows() if self._remembers else _LOOKING
        for entry in self._entries:
            entry.compute(obs, rows)
        return obs

    def _rows(self) -> Rows:
        """Whom this observation is for; the next one is for nobody."""
        stepped, self.stepped = self.stepped, _NOBODY
        fresh = self._fresh if self._fresh.any() else None
        if fresh is not None and (stepped is None or len(stepped)):
            self._fresh = fresh.copy()
            self._fresh[slice(None) if stepped is None else stepped] = False
        return Rows(stepped, fresh)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin these environments' episodes; delays are drawn, the past is filled anew."""
        super().reset(env_ids)
        if self._remembers:
            self._fresh[slice(None) if env_ids is None else env_ids] = True
            for entry in self._entries:
                entry.restart(env_ids)

    def columns(self, group: str = "policy") -> dict[str, int]:
        """Widths of a group's entries in the flattened vector, by name, in its order.

        They are known once the environment is built.

        Raises:
            ValueError: If no term is in the group; lists the groups.
        """
        widths = {entry.path: entry.width for entry in self._entries}
        return {"/".join(path): widths[path] for path in self._paths(group)}

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

    def state_dict(self) -> dict[str, Any]:
        """Noise, delays and histories, and the state of terms that are classes (copies)."""
        if not self._remembers:
            return super().state_dict()
        memories = {entry.term.name: entry.state_dict() for entry in self._entries}
        return {**super().state_dict(), "memories": memories, "fresh": self._fresh.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        if self._remembers:
            self._fresh[:] = state["fresh"]
            for entry in self._entries:
                entry.load_state_dict(state["memories"][entry.term.name])
