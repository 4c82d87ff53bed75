"""Trained policies that ship with the package: TorchScript files, and how each was made.

``policies/TASK.pt`` is the policy of the shipped task with that name, ``policies/TASK.json`` what
`Pretrained` contains. `scripts/make_policies.py` writes both.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["Pretrained", "pretrained", "pretrained_tasks"]

FOLDER = Path(__file__).parent / "policies"


@dataclass(frozen=True, slots=True)
class Pretrained:
    """How a policy was made, and how often it succeeds.

    Attributes:
        task: The task's name.
        algo: The algorithm.
        command: The command that trained it, with its seed.
        commit: The commit of this repository that trained it.
        mujoco: MuJoCo's version.
        torch: torch's version.
        env_steps: Environment steps of the training.
        train_seconds: Duration of the training in seconds, on two cores, which may have done other
            work meanwhile.
        evaluated: The command that evaluated it.
        episodes: Episodes of the evaluation.
        success: Share of these that succeeded.
        interval: 95 % interval of the success rate (Wilson).
        sha256: Hash of the file, in hexadecimal.
    """

    task: str
    algo: str
    command: str
    commit: str
    mujoco: str
    torch: str
    env_steps: int
    train_seconds: float
    evaluated: str
    episodes: int
    success: float
    interval: tuple[float, float]
    sha256: str

    @property
    def file(self) -> Path:
        """The TorchScript file."""
        return FOLDER / f"{self.task}.pt"

    def to_json(self) -> str:
        """Return it as one JSON object, a key on a line."""
        return json.dumps(asdict(self), indent=2) + "\n"


def pretrained_tasks() -> list[str]:
    """Return the names of the tasks that a policy ships for."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def pretrained(task: str) -> Pretrained:
    """Return the policy that ships for a task.

    Raises:
        ConfigError: If there is none; lists the tasks that have one.
    """
    tasks = pretrained_tasks()
    if task not in tasks:
        message = f"no trained policy ships for task {task}; tasks with one: {', '.join(tasks)}"
        raise ConfigError([Problem("policy", message, did_you_mean(task, tasks).strip())])
    values = json.loads((FOLDER / f"{task}.json").read_text(encoding="utf-8"))
    values["interval"] = tuple(values["interval"])
    return Pretrained(**values)
