"""The time step of a new task: `time_step` tries the task with the robot's file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from embodichain.cli.new_task.task_trials import trial_env
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import NewEmbodiment

__all__ = ["TimeStep", "time_step"]

_LADDER = (0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)
"""Time steps that are tried, s, largest first."""
_CONTROL_PERIOD = 0.02  # s; 50 Hz
_STEPS = 50
"""Control steps of a trial: one second."""


@dataclass(frozen=True)
class TimeStep:
    """A time step and why it was chosen.

    Attributes:
        dt: Seconds per physics step.
        why: Why it was chosen, a phrase for the user.
        of_file: Whether it is the file's.
        period: Seconds of a control step.
    """

    dt: float
    why: str = ""
    of_file: bool = False
    period: float = _CONTROL_PERIOD

    @property
    def steps(self) -> int:
        """Physics steps per control step."""
        return max(1, round(self.period / self.dt))

    @property
    def words(self) -> dict[str, str]:
        """The template variables."""
        dt = f"{self.dt:g}"
        return {
            "physics_dt": dt,
            "pad": " " * max(1, 12 - len(dt)),
            "origin": ": the file's" if self.of_file else "",
            "steps": str(self.steps),
            "steps_pad": " " * max(1, 12 - len(str(self.steps))),
        }


def time_step(
    file_dt: float | None,
    text: Callable[[TimeStep], str],
    embodiment: NewEmbodiment | None = None,
    period: float = _CONTROL_PERIOD,
) -> TimeStep:
    """Return the file's time step, or the largest of a ladder, with which the task is stable.

    Args:
        file_dt: The time step of an MJCF, s; a URDF has none.
        text: Makes the YAML of the task.
        embodiment: The task's embodiment, if it has one.
        period: Seconds of a control step.
    """
    candidates = list(_LADDER)
    if file_dt is not None:
        candidates = [file_dt, *(dt for dt in _LADDER if dt < file_dt)]
    unstable: list[str] = []
    for dt in candidates:
        try:
            diverges = _diverges(text(TimeStep(dt, period=period)), embodiment)
        except ConfigError:
            why = f"{_origin(dt, file_dt)}; not tried, because the task has mistakes"
            return TimeStep(dt, why, dt == file_dt, period)
        if not diverges:
            return TimeStep(dt, _why(dt, file_dt, unstable), dt == file_dt, period)
        unstable.append(f"{dt:g}")
    why = f"the task diverges with it, and with {', '.join(unstable[1:]) or 'no other'} s too"
    first = candidates[0]
    return TimeStep(first, f"{_origin(first, file_dt)}; {why}", file_dt is not None, period)


def _origin(dt: float, file_dt: float | None) -> str:
    return "the file's" if dt == file_dt else "the largest that was tried"


def _why(dt: float, file_dt: float | None, unstable: list[str]) -> str:
    """Why a stable time step was chosen.

    Args:
        dt: The time step, s.
        file_dt: The file's.
        unstable: The larger ones with which the task diverges.
    """
    trial = f"{_STEPS} control steps of zero and of random actions"
    if not unstable:
        return f"{_origin(dt, file_dt)}; stable in {trial}"
    larger = f"{', '.join(unstable)} s"
    if file_dt is not None:
        larger += " (the file's first)"
    return f"the largest that is stable in {trial}, which diverge with {larger}"


def _diverges(yaml: str, embodiment: NewEmbodiment | None) -> bool:
    """Whether an environment of a task diverges, two with zero and two with random actions."""
    from embodichain.lab.gym.policies import resolve_policy

    with trial_env(yaml, embodiment, num_envs=4) as env:
        obs, _ = env.reset(seed=0)
        zero = resolve_policy("zero")
        random = resolve_policy("random")
        for _ in range(_STEPS):
            action = zero(obs, env)
            action[2:] = random(obs, env)[2:]
            obs, *_, info = env.step(action)
            if info["diverged"].any():
                return True
    return False
