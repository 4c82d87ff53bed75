"""`CurriculumManager`: changes of the task as training goes on.

The terms themselves are in `envs/mdp/curriculum`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.cfg import CurriculumCfg
from embodichain.lab.gym.envs.managers.base import Manager

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["CurriculumManager"]


class CurriculumManager(Manager[CurriculumCfg]):
    """Calls every term for environments that are about to be reset, before anything of the reset.

    A term returns what it has set, a number, or several by name, or None; ``info["curriculum"]`` of
    every step holds them as they stand. Time is `env.control_step`, which goes on through resets.

    Args:
        env: The environment, with all other managers.
        cfgs: Name -> curriculum.

    Attributes:
        values: What the terms returned last: ``TERM``, or ``TERM/NAME``.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, CurriculumCfg]) -> None:
        super().__init__(env, "curriculum", "curriculum", cfgs)
        self.values: dict[str, float] = {}

    def compute(self, env_ids: EnvIndex | None) -> None:
        """Call the terms.

        Args:
            env_ids: (n,) sorted unique int64 environments about to be reset, or None for all.
        """
        for name, term in self.terms.items():
            value = term.call(self.env, env_ids)
            if isinstance(value, Mapping):
                self.values |= {f"{name}/{key}": float(v) for key, v in value.items()}
            elif value is not None:
                self.values[name] = float(value)

    def state_dict(self) -> dict[str, Any]:
        """What was set, and the state of terms that are classes (copies)."""
        return {**super().state_dict(), "values": dict(self.values)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self.values = dict(state["values"])
