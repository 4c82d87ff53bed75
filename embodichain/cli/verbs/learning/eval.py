"""`embodichain eval`: exactly N episodes of a policy, with confidence intervals.

The evaluation at the end of `train` uses the same functions.
"""

from __future__ import annotations

import json
import logging
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli.jobs.job import FRESH, Job, execute, output_overrides
from embodichain.cli.jobs.trained import Target, one_target, take
from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.cli.jobs.work.evaluate_job import (
    EvaluationPlan,
    evaluate_job,
    evaluation_config,
    objective_of,
)
from embodichain.cli.results.summaries import evaluation_rows
from embodichain.cli.terminal.output import print_facts, print_json
from embodichain.cli.verb import OverrideOptions, command_line, overrides, verb
from embodichain.config.run_folder import CHECKPOINT, SUMMARY
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = [
    "EvaluationPlan",
    "command",
    "evaluate_job",
    "evaluation_config",
    "objective_of",
]

_log = logging.getLogger(__name__)
_EPISODES = "100"
_WORDS = {"true": True, "false": False}


@verb(
    "eval",
    ("eval last", "the newest training, 100 episodes"),
    ("eval outputs/latest episodes=500 seed=7", "more of them, others"),
    ("eval last deterministic=false", "actions drawn as in training"),
    ("eval policy.onnx task=reach", "a file, in a task"),
    ("eval random task=reach episodes=50 record=none", "random actions, without a log"),
    options=OverrideOptions,
    keys=True,
    config_dir=True,
    quiet=True,
)
@overrides("RUN|last|PATH [task=NAME] [KEY=VALUE]...", "last")
def command(options: OverrideOptions) -> None:
    """Evaluate one policy in a new run folder."""
    from embodichain.config.keys.schema import LARGEST_TRAINING_SEED
    from embodichain.learning.evaluation.evaluation import EVAL_SEED_OFFSET

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
    resolved = target.resolve([*lines, *output_overrides(options)], fresh)
    if not typed_seed and target.run is not None:
        seed = int(resolved.tree["seed"]) % EVAL_SEED_OFFSET  # the training's
    if seed > LARGEST_TRAINING_SEED:
        message = f"must be from 0 to {LARGEST_TRAINING_SEED}, got {seed}"
        raise ConfigError([Problem("seed", message)])
    plan = EvaluationPlan(episodes, seed, _WORDS[word.lower()])
    config = evaluation_config(resolved, plan, trim=trim)
    same = _same_as(target, plan, config)
    execute(config, lambda job: _evaluate(job, plan, same), command_line())


def _same_as(target: Target, plan: EvaluationPlan, config: Resolved) -> str | None:
    """A sentence if the training's own evaluation played the same episodes of the same policy."""
    from embodichain.config.keys.schema import LARGEST_TRAINING_SEED

    summary_file = None if target.run is None else target.run / SUMMARY
    if summary_file is None or not summary_file.is_file() or target.file is None:
        return None
    try:
        before = json.loads(summary_file.read_text(encoding="utf-8")).get("eval")
    except (OSError, ValueError):  # it is not a result of this evaluation
        return None
    if not before or target.file.name != Path(CHECKPOINT).name or not plan.deterministic:
        return None
    mine = (plan.seed, plan.episodes, int(config.tree["num_envs"]))
    if mine != (before.get("seed"), before.get("episodes"), before.get("num_envs")):
        return None
    if config.overrides and any(line.startswith("task") for line in config.overrides):
        return None
    other = (plan.seed + 1) % (LARGEST_TRAINING_SEED + 1)
    return f"the same episodes as at the end of the training, no confirmation: seed={other}"


def _integer(key: str, word: str, *, least: int) -> int:
    with suppress(ValueError):
        if (value := int(word)) >= least:
            return value
    raise ConfigError([Problem(key, f"must be an integer of at least {least}, got {word!r}")])


def _evaluate(job: Job, plan: EvaluationPlan, same: str | None) -> float | None:
    """Evaluate, write `eval.json` and print the results."""
    result = evaluate_job(job, plan)
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
