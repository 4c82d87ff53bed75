"""`embodichain eval`: exactly N episodes of a policy, with confidence intervals.

The evaluation at the end of `train` uses the same functions.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from embodichain.cli.app import command_line, overrides, verb
from embodichain.cli.jobs.job import FRESH, Job, execute, job_options, policy_of
from embodichain.cli.jobs.trained import Target, one_target, take
from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.cli.results.summaries import evaluation_rows
from embodichain.cli.terminal.output import print_facts, print_json, to_json
from embodichain.cli.terminal.reporting import ProgressDisplay, episodes_of
from embodichain.config.run_folder import CHECKPOINT, SUMMARY
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.learning.episode_statistics import EpisodeStatistics

__all__ = [
    "Asked",
    "command",
    "evaluate_job",
    "evaluation_config",
    "objective_of",
]

_log = logging.getLogger(__name__)
EVAL_FILE = "eval.json"
_EPISODES = "100"
_WORDS = {"true": True, "false": False}


@dataclasses.dataclass(frozen=True, slots=True)
class Asked:
    """The options of an evaluation.

    Attributes:
        episodes: Number of episodes over all environments.
        seed: As typed; the environments use this plus `EVAL_SEED_OFFSET`.
        deterministic: Whether a trained policy returns its mean action.
    """

    episodes: int
    seed: int
    deterministic: bool = True


@verb(
    "eval",
    ("eval last", "the newest training, 100 episodes"),
    ("eval outputs/latest episodes=500 seed=7", "more of them, others"),
    ("eval last deterministic=false", "actions drawn as in training"),
    ("eval policy.onnx task=reach", "a file, in a task"),
    ("eval random task=reach episodes=50 record=none", "random actions, without a log"),
    keys=True,
    config_dir=True,
    quiet=True,
)
@overrides("RUN|last|PATH [task=NAME] [KEY=VALUE]...", "last")
def command(**kwargs: Any) -> None:
    """Evaluate one policy in a new run folder."""
    from embodichain.config.keys.schema import LARGEST_TRAINING_SEED
    from embodichain.learning.evaluation.evaluation import EVAL_SEED_OFFSET

    options = SimpleNamespace(**kwargs)
    target, lines = one_target("evaluate", options.words)
    refuse_unread("eval", lines)
    episodes = _integer("episodes", take(lines, "episodes", _EPISODES), least=1)
    word = take(lines, "deterministic", "true")
    if word.lower() not in _WORDS:
        raise ConfigError([Problem("deterministic", f"must be true or false, got {word!r}")])
    typed_seed = take(lines, "seed", "")
    seed = _integer("seed", typed_seed or "0", least=0)
    trim = not any(line.startswith("num_envs=") for line in lines)
    fresh = {**FRESH, "viewer": {"name": "none"}, "record": {}}
    resolved = target.resolve([*lines, *job_options(options)], fresh)
    if not typed_seed and target.run is not None:
        seed = int(resolved.tree["seed"]) % EVAL_SEED_OFFSET  # the training's
    if seed > LARGEST_TRAINING_SEED:
        message = f"must be from 0 to {LARGEST_TRAINING_SEED}, got {seed}"
        raise ConfigError([Problem("seed", message)])
    asked = Asked(episodes, seed, _WORDS[word.lower()])
    config = evaluation_config(resolved, asked, trim=trim)
    same = _same_as(target, asked, config)
    execute(config, lambda job: _evaluate(job, asked, same), command_line())


def _same_as(target: Target, asked: Asked, config: Resolved) -> str | None:
    """A sentence if the training's own evaluation played the same episodes of the same policy."""
    from embodichain.config.keys.schema import LARGEST_TRAINING_SEED

    summary_file = None if target.run is None else target.run / SUMMARY
    if summary_file is None or not summary_file.is_file() or target.file is None:
        return None
    try:
        before = json.loads(summary_file.read_text(encoding="utf-8")).get("eval")
    except (OSError, ValueError):  # it is no result of this evaluation
        return None
    if not before or target.file.name != Path(CHECKPOINT).name or not asked.deterministic:
        return None
    mine = (asked.seed, asked.episodes, int(config.tree["num_envs"]))
    if mine != (before.get("seed"), before.get("episodes"), before.get("num_envs")):
        return None
    if config.overrides and any(line.startswith("task") for line in config.overrides):
        return None
    other = (asked.seed + 1) % (LARGEST_TRAINING_SEED + 1)
    return f"the same episodes as at the end of the training, no confirmation: seed={other}"


def _integer(key: str, word: str, *, least: int) -> int:
    with suppress(ValueError):
        if (value := int(word)) >= least:
            return value
    raise ConfigError([Problem(key, f"must be an integer of at least {least}, got {word!r}")])


def _evaluate(job: Job, asked: Asked, same: str | None) -> float | None:
    """Evaluate, write `eval.json` and print the results."""
    result = evaluate_job(job, asked)
    result |= job.film(result["log"])
    if same is not None and job.quiet:
        _log.warning(same)
    elif same is not None:
        _log.info(same)
    if job.root.json:
        print_json(result)
    elif not job.quiet:
        interval = f"{result['confidence']:.0%} intervals"
        policy, episodes, *rows = evaluation_rows(result)
        note = [("note", same)] if same is not None else []
        title = f"{result['task']}  ([low, high]: {interval})"
        print_facts(title, [policy, episodes, *note, *rows])
    return objective_of(result)


def evaluation_config(resolved: Resolved, asked: Asked, *, trim: bool = True) -> Resolved:
    """Return the config of an evaluation's environment.

    Args:
        resolved: The config of the run to evaluate.
        asked: The options of the evaluation.
        trim: Whether to reduce the number of environments to the number of episodes.

    Raises:
        ConfigError: The log is configured to show environments that the evaluation does not have.
    """
    from embodichain.learning.evaluation.evaluation import EVAL_SEED_OFFSET

    count = int(resolved.tree["num_envs"])
    if trim:
        count = min(count, asked.episodes)
    record = resolved.root.record
    beyond = [i for i in record.view_envs if i >= count]
    if beyond and record.format != "none":
        message = f"no such environments: {beyond}; the evaluation has {count}"
        raise ConfigError([Problem("record.view_envs", message)])
    episodes = -(-asked.episodes // count)
    return resolved.changed(num_envs=count, episodes=episodes, seed=EVAL_SEED_OFFSET + asked.seed)


def evaluate_job(job: Job, asked: Asked) -> dict[str, Any]:
    """Build, roll out, log, and write `eval.json` into the run's folder.

    Args:
        job: A job with a config of `evaluation_config` that names the policy. If a signal stops
            it, the episodes until then count.
        asked: The options of the evaluation.

    Returns:
        The content of `eval.json`.
    """
    from embodichain.config.environments.factory import make_batch
    from embodichain.learning.evaluation.evaluation import evaluate, quotas

    task = job.resolved.task_name
    env = make_batch(job.resolved, run_dir=job.folder)
    try:
        policy = policy_of(job.root, env, deterministic=asked.deterministic)
        quota = quotas(asked.episodes, env.num_envs).tolist()
        recorder = job.attach_log(env, quota=quota)
        job.attach_viewer(env, realtime=False, resets=False)
        job.begin()
        unit = episodes_of(env.num_envs)
        with ProgressDisplay(task, asked.episodes, unit, quiet=job.quiet) as display:

            def watch(counted: EpisodeStatistics) -> bool:
                if display.due or counted.complete:
                    display.show(counted.episodes, _facts(counted))
                return job.stop.is_stopped()

            found = evaluate(env, policy, asked.episodes, seed=asked.seed, watch=watch)
    finally:
        env.close()  # finishes the log too
    result = {
        "task": task,
        "policy": job.root.policy,
        "deterministic": asked.deterministic,
        "folder": str(job.folder),
        "log": str(recorder.stats.path) if recorder is not None else None,
        "changed": [str(change) for change in getattr(policy, "changed", ())],
        **found.as_dict(),
    }
    text = to_json(job.resolved.record(result), indent=2)
    write_text(job.folder / EVAL_FILE, text + "\n")
    return result


def _facts(counted: EpisodeStatistics) -> dict[str, str]:
    facts = {"step": f"{counted.steps}"}
    for name, form in (("return", ".3g"), ("success", ".0%")):
        mean = counted.mean(name)
        if mean is not None:
            facts[name] = format(mean, form)
    return facts


def objective_of(result: Mapping[str, Any]) -> float | None:
    """Return the objective for a sweeper: the success rate, else the mean return."""
    if result["success"] is not None:
        return float(result["success"]["rate"])
    return None if result["returns"] is None else float(result["returns"]["mean"])
