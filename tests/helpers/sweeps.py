"""Tiny sweeps for tests, and what their jobs learned."""

import csv
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


STUDY = """
tasks: [cart_pole]
arms: {zero: {policy: zero}, broken: {policy: 'broken_policy:act'}}
evaluate: {episodes: 2, record: false}
"""


def write_study(folder: Path) -> None:
    """Write the study `tiny` into a folder, with an arm whose policy raises an error."""
    (folder / "conf/study").mkdir(parents=True)
    (folder / "conf/study/tiny.yaml").write_text(STUDY)
    code = "def act(obs, env):\n    raise RuntimeError('no arm')\n"
    (folder / "broken_policy.py").write_text(code)


def check_study(folder: Path, code: int, said: str) -> None:
    """Check what a launcher has made of the study `tiny`: the arm that works has its results."""
    assert code == 1, said
    assert "broken-cart_pole-0: eval-clean failed: " in said and "no arm" in said
    assert "1 of 2 jobs failed; the same command runs them again" in said
    with (folder / "outputs/studies/tiny/episodes.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["arm"], row["episode"]) for row in rows] == [("zero", "0"), ("zero", "1")]
