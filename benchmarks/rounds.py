"""How arms take turns, and what is kept of it: rounds in random order, medians, spread."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from statistics import median

import mujoco

from benchmarks.arms import Arm
from embodichain.lab.sim.engine.cpu.mujoco_process import stop_timers

EPISODE = 100
"""Every timed stretch is whole episodes of this many steps, so that resets are in it."""


@dataclass(frozen=True)
class Result:
    """One arm. Speeds are control steps/s, summed over environments.

    Attributes:
        name: The arm.
        num_envs: N.
        floor: The arm that it is compared with.
        speeds: One a round.
        ratios: Speed over the floor's of the same round.
    """

    name: str
    num_envs: int
    floor: str
    speeds: list[float]
    ratios: list[float]

    @property
    def speed(self) -> float:
        """Median of the rounds."""
        return median(self.speeds)

    @property
    def ratio(self) -> float:
        """Median of the rounds' ratios."""
        return median(self.ratios)

    def facts(self) -> dict[str, object]:
        """Everything, for JSON."""
        return {
            **asdict(self),
            "speed_median": self.speed,
            "ratio_median": self.ratio,
            "ratio_min": min(self.ratios),
            "ratio_max": max(self.ratios),
        }


def steps_for(arm: Arm, seconds: float, episode: int) -> int:
    """Control steps, whole episodes, that take about so many seconds."""
    timed(arm, 4)
    speed = 16 / timed(arm, 16)
    return episode * max(1, round(seconds * speed / episode))


def timed(arm: Arm, steps: int) -> float:
    """Seconds for so many control steps."""
    mujoco.set_mjcb_time(None)
    if not arm.timers:
        stop_timers()
    arm.prepare()
    start = time.perf_counter()
    for step in range(steps):
        arm.step(step)
    arm.finish()
    return time.perf_counter() - start


def measure(
    arms: Sequence[Arm],
    rounds: int,
    seconds: float,
    episode: int = EPISODE,
    say: Callable[[str], object] = print,
) -> list[Result]:
    """Let arms of any size take turns in random order.

    Args:
        arms: All of them, built; every arm's floor is among them, with the same size.
        rounds: How often each has its turn.
        seconds: About how long a turn is.
        episode: Control steps that a turn is a multiple of.
        say: Told about every round.
    """
    order = random.Random(0)
    steps = {_key(arm): steps_for(arm, seconds, episode) for arm in arms}
    speeds: dict[tuple[str, int], list[float]] = {key: [] for key in steps}
    for number in range(rounds):
        begun = time.perf_counter()
        # Sizes one after the other, and arms of one size in random order: a machine whose speed
        # wanders wanders less within a size, and ratios are between arms of one size.
        for size in order.sample(sizes := sorted({arm.num_envs for arm in arms}), len(sizes)):
            turn = [arm for arm in arms if arm.num_envs == size]
            for arm in order.sample(turn, len(turn)):
                count = steps[_key(arm)]
                speeds[_key(arm)].append(size * count / timed(arm, count))
        say(f"round {number + 1} of {rounds}: {time.perf_counter() - begun:.0f} s")
    return [_result(arm, speeds) for arm in arms]


def _key(arm: Arm) -> tuple[str, int]:
    return arm.name, arm.num_envs


def _result(arm: Arm, speeds: dict[tuple[str, int], list[float]]) -> Result:
    own, floor = speeds[_key(arm)], speeds[arm.floor, arm.num_envs]
    ratios = [a / b for a, b in zip(own, floor, strict=True)]
    return Result(arm.name, arm.num_envs, arm.floor, own, ratios)
