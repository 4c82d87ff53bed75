"""Who learns `reach` in `train.py`: PPO in four dresses, each timed where it spends its time."""

from __future__ import annotations

import io
import time
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from benchmarks import arms
from benchmarks.plain_task import PlainTask
from benchmarks.ppo_loop import EPISODES, PpoLoop, Settings

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnv


__all__ = ["DUMMY", "LOOP", "OURS", "PARTS", "TRAIN", "Learner", "Settings", "build"]

OURS, TRAIN = "SB3 on SB3VecEnv", "embodichain train"
DUMMY, LOOP = "SB3 on DummyVecEnv", "PPO in one file"
PARTS = ("physics", "environment", "policy", "update")
"""Physics; the rest of the environment's step; the rest of a rollout; what is between rollouts."""


@dataclass
class Learner:
    """Something that learns for a number of rollouts.

    Attributes:
        name: What it is.
        learn: Rolls out and updates so many times.
        close: Frees it.
        spent: Seconds by part.
    """

    name: str
    learn: Callable[[int], object]
    close: Callable[[], object]
    spent: Counter[str] = field(default_factory=Counter)


def build(name: str, count: int, settings: Settings, seed: int, folder: Path) -> Learner:
    """A learner of a name, with an environment of its own."""
    torch.set_num_threads(1)
    if name == LOOP:
        return _loop(count, settings, seed)
    if name == TRAIN:
        return _train(count, settings, seed, folder)
    vec = vec_env(name, count, seed)
    model = sb3(vec, settings, seed)
    learner = Learner(name, lambda rollouts: None, vec.close)
    clock = _clock(learner, vec)
    steps = count * settings.n_steps
    learner.learn = lambda rollouts: model.learn(
        rollouts * steps, clock, log_interval=1, reset_num_timesteps=False
    )
    return learner


def vec_env(name: str, count: int, seed: int) -> VecEnv:
    """`reach` as Stable-Baselines3 sees it: our batch, or a loop over plain environments."""
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    from embodichain.learning import SB3VecEnv

    env = arms.make("reach", count if name == OURS else 1)
    if name == OURS:
        return SB3VecEnv(env)
    env.reset(seed=seed)
    engine, nstep = env.sim.engine, env.sim_steps_per_control
    model, row = engine.model, engine.rows[0].copy()
    # As `make_vec_env` does it: Monitor counts episodes, which ours does as well.
    return DummyVecEnv([lambda: Monitor(PlainTask(model, row, nstep)) for _ in range(count)])


def sb3(vec: VecEnv, settings: Settings, seed: int) -> PPO:
    """Stable-Baselines3's PPO with these settings."""
    from stable_baselines3 import PPO

    arguments = asdict(settings)
    kwargs = {"log_std_init": arguments.pop("log_std_init")}
    return PPO(
        "MlpPolicy", vec, seed=seed, device="cpu", policy_kwargs=kwargs,
        stats_window_size=EPISODES, **arguments,
    )  # fmt: skip


def time_to_success(
    name: str, count: int, settings: Settings, seed: int, success: float, limit: int
) -> dict[str, Any]:
    """Seconds and steps until so many of the last 200 episodes are a success; None if not within.

    Building is not counted, learning from the first step is.
    """
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)

    class Stop(BaseCallback):
        def _on_step(self) -> bool:
            found = self.model.ep_success_buffer
            return len(found) < EPISODES or sum(found) < success * EPISODES

    vec = vec_env(name, count, seed)
    model = sb3(vec, settings, seed)
    begun = time.perf_counter()
    model.learn(limit, Stop(), log_interval=None)
    seconds = time.perf_counter() - begun
    solved = sum(model.ep_success_buffer) >= success * EPISODES
    vec.close()
    return {"seconds": seconds if solved else None, "env_steps": model.num_timesteps}


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def _train(count: int, settings: Settings, seed: int, folder: Path) -> Learner:
    """What `embodichain train` does with it: statistics, logs, and the dashboard on a terminal."""
    from embodichain.cli.jobs.work.dashboard import Dashboard
    from embodichain.learning import SB3VecEnv
    from embodichain.learning.evaluation.episodes import TrainStatistics
    from embodichain.learning.training.session import Session

    vec = SB3VecEnv(arms.make("reach", count))
    model = sb3(vec, settings, seed)
    learner = Learner(TRAIN, lambda rollouts: None, vec.close)

    def learn(rollouts: int) -> None:
        statistics = TrainStatistics(rollouts * count * settings.n_steps)
        model.num_timesteps = 0  # every turn is a training of its own, with this model
        with (
            redirect_stderr(_Terminal()),
            Dashboard("reach", "ppo", statistics.total_timesteps) as dashboard,
        ):
            Session(model, vec, statistics, folder).learn(
                lambda: None, lambda found: dashboard.due and dashboard.update(found)
            )
        for part, share in statistics.fractions.items():
            learner.spent[part] += share * statistics.seconds

    learner.learn = learn
    return learner


def _loop(count: int, settings: Settings, seed: int) -> Learner:
    env = arms.make("reach", count)
    loop = PpoLoop(env, settings, seed)
    learner = Learner(LOOP, loop.learn, env.close)
    spent = learner.spent
    _time(env, "step", spent, "environment")
    _split(env.sim, spent)
    _time(loop, "_collect", spent, "policy", "environment", "physics")
    _time(loop, "_advantages", spent, "policy")
    _time(loop, "_update", spent, "update")
    return learner


def _clock(learner: Learner, vec: VecEnv) -> Any:
    """A callback that times rollouts and updates; steps of the environment are timed here."""
    from stable_baselines3.common.callbacks import BaseCallback

    spent = learner.spent
    _time(vec, "step", spent, "environment")
    base = getattr(vec, "base", None)
    if base is not None:
        _split(base.sim, spent)

    class Clock(BaseCallback):
        mark = 0.0

        def _on_training_start(self) -> None:
            self.mark = time.perf_counter()

        def _on_rollout_start(self) -> None:
            self._lap("update")
            self._inner = spent["environment"] + spent["physics"]

        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            self._lap("policy")
            spent["policy"] -= spent["environment"] + spent["physics"] - self._inner

        def _on_training_end(self) -> None:
            self._lap("update")

        def _lap(self, part: str) -> None:
            now = time.perf_counter()
            spent[part] += now - self.mark
            self.mark = now

    return Clock()


def _split(sim: Any, spent: Counter[str]) -> None:
    """Take physics out of the environment's time."""
    method = sim.update

    def timed(*args: Any, **kwargs: Any) -> None:
        begun = time.perf_counter()
        method(*args, **kwargs)
        seconds = time.perf_counter() - begun
        spent["physics"] += seconds
        spent["environment"] -= seconds

    sim.update = timed


def _time(owner: Any, name: str, spent: Counter[str], part: str, *inner: str) -> None:
    """Time a method; what `inner` parts grow by inside it is theirs."""
    method = getattr(owner, name)

    def timed(*args: Any, **kwargs: Any) -> Any:
        before, begun = sum(spent[i] for i in inner), time.perf_counter()
        result = method(*args, **kwargs)
        seconds = time.perf_counter() - begun
        spent[part] += seconds - (sum(spent[i] for i in inner) - before)
        return result

    setattr(owner, name, timed)
