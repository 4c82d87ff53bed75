"""Tiny sweeps for tests, and what their jobs learned."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.learning.policies.policy import load_model

TINY = (
    *("task=cart_pole", "num_envs=4", "algo.n_steps=8", "algo.batch_size=16", "algo.n_epochs=2"),
    *("eval.episodes=2", "record=none", "sim.num_threads=1", "checkpoint.keep=20"),
)


def summary(job: Path) -> dict[str, Any]:
    """The content of a job's `summary.json`."""
    found: dict[str, Any] = json.loads((job / "summary.json").read_text())
    return found


def learned(job: Path) -> NDArray[Any]:
    """The networks of a job's final checkpoint."""
    policy = load_model(job / "checkpoints/final.zip").model.policy
    with torch.no_grad():
        return np.concatenate([p.numpy().ravel() for p in policy.parameters()])


def results(job: Path) -> dict[str, Any]:
    """What is the same of two trainings that are the same: no times, no paths."""
    found = summary(job)
    same = {n: found[n] for n in ("seed", "env_steps", "episodes", "mean_return", "objective")}
    return {**same, "eval": found["eval"]["returns"]}
