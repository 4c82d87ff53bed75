"""What verifying a log found. Pure data."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["Difference", "VerifyReport"]


@dataclass(frozen=True, slots=True)
class Difference:
    """The first place where the log and the simulation part.

    Attributes:
        step: Control step, from 0.
        env: The environment.
        field: Component and index, ``qpos[3]``; ``hash`` where the row that physics returned is
            gone (the environment was reset in that step) and only its hash tells, or where no
            column of the next state differs: it is the hash, or an input that the state leaves out.
        recorded: The value in the log.
        simulated: The value that physics and the recorded writes give.
    """

    step: int
    env: int
    field: str
    recorded: float | int
    simulated: float | int

    def __str__(self) -> str:
        """Return one line."""
        if self.field == "hash":
            values = f"recorded {self.recorded:#018x}, simulated {self.simulated:#018x}"
        else:
            values = f"recorded {self.recorded!r}, simulated {self.simulated!r}"
        return f"step {self.step}, environment {self.env}, {self.field}: {values}"


@dataclass(frozen=True, slots=True)
class VerifyReport:
    """Whether a log is what physics makes of it.

    Attributes:
        path: The file.
        ok: Every state, bit for bit, to the end of a complete log.
        steps: Control steps simulated and compared.
        envs: Environments simulated.
        difference: The first difference, or None.
        problems: Why `ok` is False otherwise, one line each.
        largest_error: Approximate mode: component to largest absolute difference after one step.
        notes: What is no mistake but should be known: where a recovered log ends, what is another
            here than where the log was made.
    """

    path: Path
    ok: bool
    steps: int
    envs: int
    difference: Difference | None = None
    problems: list[str] = field(default_factory=list)
    largest_error: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        """Return the verdict, and every reason on its own line."""
        count = f"{self.steps} steps of {self.envs} environment{'s' if self.envs != 1 else ''}"
        if self.ok:
            return "\n".join([f"verified: {count} are identical to the bit", *self.notes])
        lines = [f"NOT verified ({count} compared)"]
        if self.difference is not None:
            lines.append(f"first difference: {self.difference}")
        lines += self.problems
        if self.largest_error:
            errors = ", ".join(f"{k} {v:.3g}" for k, v in self.largest_error.items())
            lines.append(f"approximate only: largest difference after one step: {errors}")
        lines += self.notes
        return "\n".join(lines)
