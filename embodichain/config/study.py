"""`Study`: a checked study, and its jobs, each with the configs of its stages.

A job is one arm on one task with one seed: it trains, then evaluates under every variation.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from embodichain.config.composition.composed import compose, list_options
from embodichain.config.composition.locate import COMMAND_LINE
from embodichain.config.composition.study_files import compose_study, tasks_of_suite
from embodichain.config.keys.study import ArmCfg, SearchCfg, StudyCfg
from embodichain.config.resolved import Resolved, resolve
from embodichain.lab.sim.configs.config_types import ConfigTypes
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "EVERY_TASK_HAS",
    "Study",
    "StudyJob",
    "check_jobs",
    "read_study",
    "resolve_study",
    "search_lines",
]

EVERY_TASK_HAS = ("return", "length")
"""Metrics that need no declaration in a task."""


_SET_IN_TRAININGS = {
    "task": "Write tasks=[...].",
    "seed": "Write seeds=[...].",
    "policy": "An arm with a policy has `policy`, and no training.",
    "output_dir": "Write output_dir of the study.",
    "resume": "The same command continues a training.",
}
"""Key -> where a study has it."""
_SET_IN_EVALUATIONS = {
    **_SET_IN_TRAININGS,
    "policy": "Write policy of the arm.",
    "resume": "An evaluation is not continued.",
    "episodes": "Write evaluate.episodes.",
    "num_envs": "Write evaluate.episodes: each is the first one of an environment.",
    "variation": "Write evaluate.variations.",
}
"""The same of evaluations."""


@dataclass(frozen=True)
class StudyJob:
    """One arm on one task with one seed.

    Attributes:
        arm: The arm's name.
        task: The task.
        seed: The seed.
        study: The study.
    """

    arm: str
    task: str
    seed: int
    study: Study

    @property
    def name(self) -> str:
        """Its name, which is that of its folder."""
        return f"{self.arm}-{self.task.replace('/', '.')}-{self.seed}"

    @property
    def arm_cfg(self) -> ArmCfg:
        """The arm's config."""
        return self.study.arms[self.arm]

    @property
    def trains(self) -> bool:
        """Whether the job has a training."""
        return self.arm_cfg.policy is None

    def training(self, chosen: Sequence[str] = ()) -> Resolved:
        """Return the config of the training.

        Args:
            chosen: Overrides that a search has chosen.

        Raises:
            ConfigError: Lists every mistake.
        """
        resolved = resolve(compose(self._training_lines(chosen), "train"), "train")
        wandb = dict(resolved.tree.get("wandb") or {})
        if wandb.get("group") is None:  # runs of a study are found together
            wandb["group"] = self.study.name
        if wandb.get("name") is None:
            wandb["name"] = self.name
        return resolved.changed(wandb=wandb)

    def evaluation(self, variation: str, chosen: Sequence[str] = ()) -> Resolved:
        """Return the config of the evaluation under a variation, without the trained policy.

        Args:
            variation: A name of the study's `evaluate.variations`.
            chosen: Overrides that a search has chosen.

        Raises:
            ConfigError: Lists every mistake.
        """
        evaluate = self.study.cfg.evaluate
        lines = [*evaluate.overrides, *self.arm_cfg.evaluate, *self._variation_lines(variation)]
        if self.trains:
            resolved = resolve(compose([*self._training_lines(chosen), *lines], "train"), "train")
        else:
            lines = [f"task={self.task}", *lines, f"seed={self.seed}"]
            policy = str(self.arm_cfg.policy)
            if not Path(policy).exists():
                lines.append(f"policy={policy}")
            resolved = resolve(compose(lines, "run"), "run")
            if Path(policy).exists():  # a path may have signs of Hydra's grammar
                resolved = resolved.changed(policy=policy)
        # What a training chooses and warns of, it says when it is trained.
        notes = tuple(note for note in resolved.notes if not note.path.startswith("algo"))
        # A policy of this job was trained in the task that the study says; one of a file may differ
        # by the variations alone, unless `allow_changed=true` is among the overrides.
        return replace(resolved, notes=notes).changed(
            num_envs=evaluate.episodes,
            allow_changed=self.trains or bool(resolved.tree["allow_changed"]),
            record={**resolved.tree["record"], **({} if evaluate.record else {"format": "none"})},
            quiet=True,
        )

    def _training_lines(self, chosen: Sequence[str]) -> list[str]:
        lines = [f"task={self.task}", *self.study.cfg.train, *self.arm_cfg.train, *chosen]
        return [*lines, f"seed={self.seed}", "eval.episodes=0", "quiet=true"]

    def _variation_lines(self, variation: str) -> list[str]:
        strengths = self.study.cfg.evaluate.variations[variation]
        if not strengths:
            return []
        lines = [f"variation=[{','.join(strengths)}]"]
        lines += [f"task.variations.{name}.strength={value}" for name, value in strengths.items()]
        return lines


@dataclass(frozen=True)
class Study:
    """A checked study.

    Attributes:
        name: Its name.
        cfg: Its config.
        tree: The same as plain values.
        tasks: Its tasks, those of the suite included.
        overrides: As typed.
    """

    name: str
    cfg: StudyCfg
    tree: Mapping[str, Any]
    tasks: tuple[str, ...]
    overrides: tuple[str, ...] = ()

    @property
    def arms(self) -> dict[str, ArmCfg]:
        """Name -> arm; a list of overrides is an arm that trains with them."""
        arms: dict[str, ArmCfg] = {}
        for name, arm in self.cfg.arms.items():
            arms[name] = ArmCfg(train=list(arm)) if isinstance(arm, list) else arm
        return arms

    @property
    def baseline(self) -> str:
        """The arm that others are compared with."""
        return self.cfg.compare.baseline or next(iter(self.cfg.arms))

    @property
    def variations(self) -> list[str]:
        """Names of the variations of the evaluations."""
        return list(self.cfg.evaluate.variations)

    def jobs(self) -> list[StudyJob]:
        """The jobs, arm by arm, so that an interrupted study has whole arms."""
        return [
            StudyJob(arm, task, seed, self)
            for arm in self.arms
            for task in self.tasks
            for seed in self.cfg.seeds
        ]

    def job(self, name: str) -> StudyJob:
        """Return the job of a name.

        Raises:
            KeyError: There is none.
        """
        return {job.name: job for job in self.jobs()}[name]

    def dump(self) -> str:
        """Return the study as JSON, for `read_study`."""
        facts = {
            "name": self.name,
            "tasks": list(self.tasks),
            "overrides": list(self.overrides),
            "config": self.tree,
        }
        return json.dumps(facts, indent=2) + "\n"


def resolve_study(name: str, overrides: Sequence[str] = ()) -> Study:
    """Compose and check a study, and the config of each stage of its jobs.

    Args:
        name: An option of the group `study`.
        overrides: As typed.

    Raises:
        ConfigError: Lists every mistake with its place.
    """
    composed = compose_study(name, overrides)
    checked = _types().check_tree(composed.tree)
    problems = [*composed.problems]
    problems += [p.at(composed.locator.source(p.path)) for p in checked.problems.values()]
    if problems or checked.value is None:
        raise ConfigError(problems)
    cfg: StudyCfg = checked.value
    tasks = list(cfg.tasks)
    if cfg.suite is not None:
        tasks += tasks_of_suite(cfg.suite)
    study = Study(
        name=name,
        cfg=cfg,
        tree=checked.tree,
        tasks=tuple(dict.fromkeys(tasks)),
        overrides=composed.overrides,
    )
    problems = [p.at(composed.locator.source(p.path)) for p in _mistakes(study)]
    if problems:
        raise ConfigError(problems)
    return study


def read_study(text: str) -> Study:
    """Read a study that `Study.dump` has written.

    Raises:
        ConfigError: The text is damaged.
    """
    try:
        facts = json.loads(text)
        checked = _types().check_tree(facts["config"])
        return Study(
            name=facts["name"],
            cfg=checked.value,
            tree=checked.tree,
            tasks=tuple(facts["tasks"]),
            overrides=tuple(facts["overrides"]),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"the record of the study is damaged: {error}") from error


def search_lines(search: SearchCfg) -> list[str]:
    """Return the keys that a search tries as overrides with sweeps: ``KEY=interval(A, B)``."""
    return [f"{key}={value}" for key, value in _flat(search.params)]


def _flat(params: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield key paths and values; overrides of a study nest keys that its file writes in one."""
    for key, value in params.items():
        key_path = f"{path}.{key}" if path else str(key)
        if isinstance(value, Mapping):
            yield from _flat(value, key_path)
        else:
            yield key_path, value


@cache
def _types() -> ConfigTypes:
    return ConfigTypes(StudyCfg)


def _mistakes(study: Study) -> Iterator[Problem]:
    """Yield mistakes that types do not show."""
    cfg = study.cfg
    if not study.tasks:
        yield Problem("tasks", "a study needs a task: tasks=[reach], or suite=arms")
    if len(set(cfg.seeds)) < len(cfg.seeds):
        yield Problem("seeds", f"a seed is listed twice: {cfg.seeds}")
    if cfg.compare.baseline is not None and cfg.compare.baseline not in study.arms:
        message = f"there is no arm {cfg.compare.baseline!r}; arms: {listing(list(study.arms))}."
        hint = did_you_mean(cfg.compare.baseline, list(study.arms)).strip()
        yield Problem("compare.baseline", message, hint)
    for name, arm in study.arms.items():
        if arm.policy is not None and (arm.train or arm.optimize is not None):
            yield Problem(f"arms.{name}", "has a policy, and keys of a training: use one of them")
        if arm.policy is not None and _is_path(arm.policy) and not Path(arm.policy).exists():
            yield Problem(f"arms.{name}.policy", f"there is no such file or folder: {arm.policy}")
    names: dict[str, StudyJob] = {}
    for job in study.jobs():
        other = names.setdefault(job.name, job)
        if other != job:
            message = f"{other.arm} on {other.task} and {job.arm} on {job.task} have one name, "
            yield Problem("arms", f"{message}{job.name}: rename an arm")
    places = {"train": cfg.train, "evaluate.overrides": cfg.evaluate.overrides}
    for name, arm in study.arms.items():
        train_place = f"arms.{name}" if isinstance(cfg.arms[name], list) else f"arms.{name}.train"
        places |= {train_place: arm.train, f"arms.{name}.evaluate": arm.evaluate}
    for place, lines in places.items():
        keys = _SET_IN_TRAININGS
        if place.endswith(("overrides", "evaluate")):
            keys = _SET_IN_EVALUATIONS
        for line in lines:
            key = line.lstrip("+~").partition("=")[0].partition("@")[0]
            if key in keys:
                yield Problem(place, f"{line}: the study sets {key}", keys[key])
    options = list_options("variation")
    for name, strengths in cfg.evaluate.variations.items():
        for variation in strengths:
            if variation not in options:
                message = f"there is no such variation; there are: {listing(options, variation)}."
                hint = did_you_mean(variation, options).strip()
                yield Problem(f"evaluate.variations.{name}.{variation}", message, hint)
    known_tasks = list_options("task")
    for task in study.tasks:
        if task not in known_tasks:
            message = f"there is no task {task!r}; there are: {listing(known_tasks, task)}."
            yield Problem("tasks", message, did_you_mean(task, known_tasks).strip())


def _is_path(policy: str) -> bool:
    return "/" in policy or Path(policy).suffix in (".zip", ".onnx", ".pt", ".npz")


def check_jobs(study: Study) -> None:
    """Check the config of every stage of a study, seeds apart, and that tasks have its metrics.

    Raises:
        ConfigError: Lists every mistake; its paths begin with the arm.
    """
    problems: dict[str, Problem] = {}
    metrics: dict[str, set[str]] = {}
    for job in study.jobs():
        if job.seed != study.cfg.seeds[0]:
            continue
        try:
            if job.trains:
                job.training()
            for variation in study.variations:
                resolved = job.evaluation(variation)
                metrics.setdefault(job.task, set(resolved.tree["task"].get("metrics") or {}))
        except ConfigError as error:
            for problem in error.problems:
                place = f"arm {job.arm}, task {job.task}"
                located = replace(problem, source=f"{place}; {problem.source or COMMAND_LINE}")
                problems.setdefault(f"{job.arm} {problem.path} {problem.message}", located)
    for task, names in metrics.items():
        for metric in study.cfg.compare.metrics:
            if metric not in names and metric not in EVERY_TASK_HAS:
                in_all = set.intersection(*metrics.values()) | set(EVERY_TASK_HAS)
                message = f"task {task} has no metric {metric!r}; "
                message += f"metrics that all tasks have: {listing(sorted(in_all))}."
                hint = did_you_mean(metric, sorted(in_all)).strip()
                problems.setdefault(f"{task} {metric}", Problem("compare.metrics", message, hint))
    if problems:
        raise ConfigError(list(problems.values()))
