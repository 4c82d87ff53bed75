"""Folders with the files of runs, written without running anything."""

import json
from pathlib import Path
from typing import Any

import yaml


def make_run(root: Path, name: str, *, task: str = "reach", **files: Any) -> Path:
    """Write the files of a run as `run`, `train` and `eval` do.

    Args:
        root: The folder of runs.
        name: Path of the run's folder in it.
        task: The task.
        **files: `config`, keys besides the usual ones; `command`, the text of its file; `summary`
            and `eval`, the content of these; `progress`, the text of `progress.csv`.
    """
    folder = root / name
    folder.mkdir(parents=True)
    config = {"seed": 1, "num_envs": 4, "output_dir": "outputs", "task": {"description": ""}}
    config |= files.get("config", {})
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    (folder / "overrides.yaml").write_text(yaml.safe_dump([f"task={task}"]))
    (folder / "command.txt").write_text(files.get("command", f"cd /\nembodichain run task={task}"))
    for key in ("summary", "eval"):
        if key in files:
            (folder / f"{key}.json").write_text(json.dumps(files[key]))
    if "progress" in files:
        (folder / "progress.csv").write_text(files["progress"])
    return folder


def summary_of(task: str, success: float, mean: float) -> dict[str, Any]:
    """The summary of a run of 20 episodes."""
    spread = {"mean": mean, "std": 1.0, "min": mean - 2, "max": mean + 2}
    return {
        "task": task,
        "status": "finished",
        "signal": None,
        "num_envs": 4,
        "episodes": 20,
        "episodes_wanted": 20,
        "control_steps": 100,
        "seconds": 1.0,
        "fps": 400.0,
        "return": spread,
        "length": {"mean": 50.0, "std": 0.0, "min": 50.0, "max": 50.0},
        "success_rate": success,
        "metrics": {},
        "rewards": {"near": mean},
        "diverged": 0,
    }


def progress(*rows: tuple[int, float]) -> str:
    """A `progress.csv` with return and success."""
    lines = ["time/total_timesteps,rollout/ep_rew_mean,rollout/success_rate"]
    lines += [f"{steps},{value},{value / 100}" for steps, value in rows]
    return "\n".join(lines)
