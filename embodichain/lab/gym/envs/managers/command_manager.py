"""`CommandManager`: goals that are no entities of the scene, drawn for each episode.

Terms are in `envs/mdp/commands`. A goal that is a place is an entity, moved by an event.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.cfg import CommandCfg
from embodichain.lab.gym.envs.managers.base import BuiltTerm
from embodichain.lab.gym.envs.managers.drawing import DrawingManager, Timer
from embodichain.lab.gym.envs.managers.term import CommandTerm
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = ["CommandManager"]


class CommandManager(DrawingManager[CommandCfg]):
    """Draws commands at resets, after reset events, and in between at their own intervals.

    A command draws by `draw`, from a stream of its own, and what it drew goes to the environment's
    observers as an event of mode ``command``. Where a term gives metrics, their means over the
    episode are ``info["metrics"]["COMMAND/METRIC"]``.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> command.

    Raises:
        ConfigError: If a term is wrong, or has no values (N, K).
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, CommandCfg]) -> None:
        super().__init__(env, "commands", "command", cfgs)
        self._timers = {
            name: Timer(self.num_envs, env.step_dt)
            for name, term in self.terms.items()
            if term.cfg.resampling_time_s is not None
        }
        self._sums: dict[str, F64] = {}
        self._steps: F64 = np.zeros(self.num_envs)

    def _bind(self) -> None:
        for name, term in self.terms.items():
            values = getattr(term.instance, "values", None)
            if not isinstance(values, np.ndarray) or values.ndim != 2:
                message = f"{term.spec.label} must set values, an array (N, K)"
                raise ConfigError([Problem(f"commands.{name}.func", message)])
            if values.shape[0] != self.num_envs or values.dtype != np.float64:
                message = f"needs float64 values ({self.num_envs}, K), got {values.shape}"
                raise ConfigError([Problem(f"commands.{name}", message)])
        instances = [(name, term.instance) for name, term in self.terms.items()]
        self._updates = [
            term.update for _, term in instances if type(term).update is not CommandTerm.update
        ]
        self._measured = [
            (name, term.metrics)
            for name, term in instances
            if type(term).metrics is not CommandTerm.metrics
        ]

    # -- what others read ----------------------------------------------------------------------

    def require(self, name: str, key: str = "command_name") -> str:
        """Return the name of a command if it exists: for terms that are built with one.

        Args:
            name: What a parameter says.
            key: The parameter, for the message.

        Raises:
            ConfigError: If there is no such command; lists those that exist.
        """
        if name not in self.terms:
            known = listing(self.terms, name)
            message = f"no command is called {name!r}; there are: {known}"
            raise ConfigError([Problem(key, message, did_you_mean(name, self.terms).strip())])
        return name

    def values(self, name: str) -> F64:
        """(N, K) float64 commands in force: a live view, not to be written to or kept."""
        values: F64 = self.terms[name].instance.values
        return values

    def get_command(self, name: str) -> torch.Tensor:
        """(N, K) float32 commands in force; a copy."""
        return torch.from_numpy(self.values(name).astype(np.float32))

    def names(self, name: str) -> tuple[str, ...]:
        """What each column of a command is."""
        instance = self.terms[name].instance
        return tuple(instance.names) or tuple(map(str, range(instance.values.shape[1])))

    # -- what the environment calls ------------------------------------------------------------

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw every command anew: for environments that were reset.

        Args:
            env_ids: (n,) sorted unique int64, or None for all.
        """
        for term in self.terms.values():
            self._run(term, "command", env_ids)
        for update in self._updates:
            update(env_ids)

    def step(self, env_ids: EnvIndex | None = None) -> None:
        """Count one control step, draw the commands that are due, and update all.

        Args:
            env_ids: (n,) environments that took the step, or None for all.
        """
        where: Any = slice(None) if env_ids is None else env_ids
        for name, timer in self._timers.items():
            due = timer.advance(env_ids)
            if len(due):
                everyone = len(due) == self.num_envs
                self._run(self.terms[name], "command", None if everyone else due)
        for update in self._updates:
            update(env_ids)
        if self._measured:
            self._steps[where] += 1.0
            self._measure(where)

    def _measure(self, where: Any) -> None:
        for name, metrics in self._measured:
            for key, value in metrics().items():
                total = self._sums.setdefault(f"{name}/{key}", np.zeros(self.num_envs))
                total[where] += value[where]

    def report(self, metrics: dict[str, torch.Tensor]) -> None:
        """Add the means over the episode so far, this step included.

        Args:
            metrics: Gains ``COMMAND/METRIC`` -> (N,) float32.
        """
        count = np.maximum(self._steps, 1.0)
        for name, total in self._sums.items():
            metrics[name] = torch.from_numpy((total / count).astype(np.float32))

    @property
    def has_metrics(self) -> bool:
        """Whether a command measures how well it is followed."""
        return bool(self._measured)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Start the episode of these environments; the draw itself comes after reset events."""
        super().reset(env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        self._steps[where] = 0.0
        for total in self._sums.values():
            total[where] = 0.0

    def _run(self, term: BuiltTerm[CommandCfg], mode: str, env_ids: EnvIndex | None) -> None:
        self._call(term, mode, env_ids, env_ids)
        timer, times = self._timers.get(term.name), term.cfg.resampling_time_s
        if timer is not None and times is not None:
            stream, (low, high) = f"commands.{term.name}.interval", times
            timer.start(env_ids, self.env.streams.uniform(stream, (), low, high, env_ids))

    def update(self, env_ids: EnvIndex | None) -> None:
        """Adjust the commands of environments to a state that they were given."""
        for update in self._updates:
            update(env_ids)

    # -- saving --------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """Commands, timers and sums (copies)."""
        return {
            **super().state_dict(),
            "left": {name: timer.left.copy() for name, timer in self._timers.items()},
            "sums": {name: total.copy() for name, total in self._sums.items()},
            "steps": self._steps.copy(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        for name, timer in self._timers.items():
            timer.left[:] = state["left"][name]
        self._sums = {name: total.copy() for name, total in state["sums"].items()}
        self._steps[:] = state["steps"]
