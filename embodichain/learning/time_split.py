"""`TimeSplit`: where the wall time of a training goes.

Who tells it when is `watch.py`; what physics and the environment took, they know themselves.
"""

from __future__ import annotations

import dataclasses
import time

from embodichain.learning.vec_env import SB3VecEnv

__all__ = ["PARTS", "TimeSplit"]

PARTS = ("physics", "environment", "policy", "update")
"""Physics steps; what else `env.step` does (observations, rewards, resets); what else a rollout
does (actions of the policy, buffers, statistics); what lies between two rollouts (the algorithm's
update, logs, checkpoints)."""


@dataclasses.dataclass
class TimeSplit:
    """Seconds by part, told where rollouts begin and end.

    Attributes:
        physics: See `PARTS`.
        environment: Likewise.
        policy: Likewise.
        update: Likewise.
    """

    physics: float = 0.0
    environment: float = 0.0
    policy: float = 0.0
    update: float = 0.0
    _mark: float | None = None
    _before: tuple[float, float] = (0.0, 0.0)

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds of each part so far."""
        return {name: getattr(self, name) for name in PARTS}

    @property
    def fractions(self) -> dict[str, float]:
        """Share of each part in all of them, 0 to 1; empty before the end of the first rollout."""
        total = sum(self.seconds.values())
        return {name: value / total for name, value in self.seconds.items()} if total > 0 else {}

    def rollout_begins(self, env: SB3VecEnv) -> None:
        """A rollout begins: what lay between the last one and this is the update's."""
        self.update += self._lap()
        self._before = _spent(env)

    def rollout_ends(self, env: SB3VecEnv) -> None:
        """A rollout ended, and the algorithm's update begins."""
        whole, (physics, steps) = self._lap(), _spent(env)
        physics, steps = physics - self._before[0], steps - self._before[1]
        self.physics += physics
        self.environment += steps - physics
        self.policy += whole - steps

    def end(self) -> None:
        """Learning ends: what came after the last rollout is the update's."""
        self.update += self._lap()
        self._mark = None

    def _lap(self) -> float:
        """Seconds since the last call; 0 in the first."""
        before, self._mark = self._mark, time.perf_counter()
        return 0.0 if before is None else self._mark - before


def _spent(env: SB3VecEnv) -> tuple[float, float]:
    return env.base.sim.physics_seconds, env.step_seconds
