"""The config of a study: arms that are trained, evaluated and compared, as data classes."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from embodichain.config.keys.schema import LARGEST_TRAINING_SEED
from embodichain.utils.configclass import configclass

__all__ = [
    "ArmCfg",
    "SearchCfg",
    "StudyCfg",
    "StudyComparisonCfg",
    "StudyEvaluationCfg",
]

PositiveInt = Annotated[int, Field(ge=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=60)]
"""A name that is a part of a folder's name."""
Seed = Annotated[int, Field(ge=0, le=LARGEST_TRAINING_SEED)]
Strength = Annotated[float, Field(ge=0, le=1)]


@configclass
class SearchCfg:
    """A search for the values of an arm's keys, before its trainings."""

    params: Annotated[dict[str, Any], Field(min_length=1)]
    """Key -> what Optuna draws: ``interval(1e-4, 1e-2)``, ``choice(32, 64)``, as of `train -m`."""
    trials: PositiveInt = 20
    """Trainings of the search; the one with the best objective gives the values."""


@configclass
class ArmCfg:
    """One of the things that a study compares. A list of texts is an arm with only `train`."""

    train: list[str] = []
    """Overrides of `train` for the trainings of this arm."""
    policy: str | None = None
    """A policy that needs no training: a name, or the file or folder of one."""
    evaluate: list[str] = []
    """Overrides of this arm's evaluations."""
    optimize: SearchCfg | None = None
    """A search, whose values are added to `train`."""


@configclass
class StudyEvaluationCfg:
    """How each trained policy, or policy without training, is evaluated."""

    episodes: PositiveInt = 100
    """Episodes for each arm, task, seed and variation. Each is the first episode of its
    environment, so that two arms with the same seed begin in the same states."""
    variations: Annotated[dict[Name, dict[str, Strength]], Field(min_length=1)] = {"clean": {}}
    """Name -> the variations of the group `variation` that are on, with their strengths."""
    overrides: list[str] = []
    """Further overrides of all evaluations, such as noise or another engine."""
    record: bool = True
    """Whether episodes are recorded: films, drawn values and receipts need it."""


@configclass
class StudyComparisonCfg:
    """What the tables of a study compare."""

    baseline: str | None = None
    """The arm that others are compared with; null is the first."""
    metrics: Annotated[list[str], Field(min_length=1)] = ["success", "return"]
    """``success``, ``return``, ``length``, and names of the tasks' metrics."""


@configclass
class StudyCfg:
    """A study: each arm, on each task, with each seed."""

    arms: Annotated[dict[Name, list[str] | ArmCfg], Field(min_length=1)]
    description: str = ""
    tasks: list[str] = []
    """Names of tasks, beside those of `suite`."""
    suite: str | None = None
    """A list of tasks of the group `suite`."""
    seeds: Annotated[list[Seed], Field(min_length=1)] = [0]
    """Of the trainings; evaluations of a training have its seed, on other streams."""
    train: list[str] = []
    """Overrides of all trainings."""
    evaluate: StudyEvaluationCfg = StudyEvaluationCfg()
    compare: StudyComparisonCfg = StudyComparisonCfg()
    output_dir: str = "outputs"
    """The folder in which the study's folder is made."""
