"""The time step of a new task: `time_step` tries the task with the robot's file."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from embodichain.utils.errors import ConfigError

__all__ = ["TimeStep", "time_step"]

_LADDER = (0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)
"""Time steps that are tried, s, largest first."""
_CONTROL_PERIOD = 0.02  # s; 50 Hz
_STEPS = 50
"""Control steps of a trial: one second."""
_TRIAL = "trial_of_a_new_task"


@dataclass(frozen=True)
class TimeStep:
    """A time step and why it was chosen.

    Attributes:
        dt: Seconds per physics step.
        why: Why it was chosen, a phrase for the user.
        of_file: Whether it is the file's.
    """

    dt: float
    why: str = ""
    of_file: bool = False

    @property
    def steps(self) -> int:
        """Physics steps per control step."""
        return max(1, round(_CONTROL_PERIOD / self.dt))

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


def time_step(file_dt: float | None, text: Callable[[TimeStep], str]) -> TimeStep:
    """Return the file's time step, or the largest of a ladder, with which the task is stable.

    Args:
        file_dt: The time step of an MJCF, s; a URDF has none.
        text: Makes the YAML of the task.
    """
    candidates = list(_LADDER)
    if file_dt is not None:
        candidates = [file_dt, *(dt for dt in _LADDER if dt < file_dt)]
    unstable: list[str] = []
    for dt in candidates:
        try:
            diverges = _diverges(text(TimeStep(dt)))
        except ConfigError:
            why = f"{_origin(dt, file_dt)}; not tried, because the task has mistakes"
            return TimeStep(dt, why, dt == file_dt)
        if not diverges:
            return TimeStep(dt, _why(dt, file_dt, unstable), dt == file_dt)
        unstable.append(f"{dt:g}")
    why = f"the task diverges with it, and with {', '.join(unstable[1:]) or 'no other'} s too"
    first = candidates[0]
    return TimeStep(first, f"{_origin(first, file_dt)}; {why}", file_dt is not None)


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


def _diverges(yaml: str) -> bool:
    """Whether an environment of a task diverges, two with zero and two with random actions."""
    import embodichain
    from embodichain.lab.gym.policies import resolve_policy

    with tempfile.TemporaryDirectory() as folder, _quiet():
        file = Path(folder, "task", f"{_TRIAL}.yaml")
        file.parent.mkdir()
        file.write_text(yaml, encoding="utf-8")
        env = embodichain.make(_TRIAL, num_envs=4, seed=0, config_dir=folder)
        try:
            obs, _ = env.reset(seed=0)
            zero = resolve_policy("zero")
            random = resolve_policy("random")
            for _ in range(_STEPS):
                action = zero(obs, env)
                action[2:] = random(obs, env)[2:]
                obs, *_, info = env.step(action)
                if info["diverged"].any():
                    return True
        finally:
            env.close()
    return False


@contextmanager
def _quiet() -> Iterator[None]:
    """Leave out messages about the file: `validate` has them."""
    logger = logging.getLogger("embodichain")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
