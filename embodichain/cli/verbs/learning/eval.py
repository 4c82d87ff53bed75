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
from embodichain.cli.jobs.trained import Target, parse_target, pop_override
from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.cli.jobs.work.evaluate_job import (
    EvaluationPlan,
    evaluate_job,
    evaluation_config,
    objective_of,
    write_evaluation_receipt,
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


@verb(
    "eval",
    ("eval last", "the newest training, 100 episodes"),
    ("eval outputs/latest episodes=500 seed=7", "more episodes, other ones"),
    ("eval last deterministic=false", "actions drawn as in training"),
    ("eval policy.onnx task=reach", "a file, in a task"),
    ("eval random task=reach episodes=50 record=none", "random actions, without a log"),
    ("eval last 'variation=[mass,noise]' task.variations.mass.strength=0.5", "varied conditions"),
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

    target, lines = parse_target("evaluate", options.words)
    refuse_unread("eval", lines)
    episodes = _parse_integer("episodes", pop_override(lines, "episodes", _EPISODES), least=1)
    deterministic = _parse_switch("deterministic", pop_override(lines, "deterministic", "true"))
    typed_seed = pop_override(lines, "seed", "")
    seed = _parse_integer("seed", typed_seed or "0", least=0)
    # Environments without an episode to play are left out, unless their number was typed.
    trim = not any(line.startswith("num_envs=") for line in lines)
    root_values = {**FRESH, "viewer": {"name": "none"}, "record": {}}
    resolved = target.resolve([*lines, *output_overrides(options)], root_values)
    if not typed_seed and target.run is not None:
        seed = int(resolved.tree["seed"]) % EVAL_SEED_OFFSET  # the training's
    if seed > LARGEST_TRAINING_SEED:
        message = f"must be from 0 to {LARGEST_TRAINING_SEED}, got {seed}"
        raise ConfigError([Problem("seed", message)])
    plan = EvaluationPlan(episodes, seed, deterministic)
    config = evaluation_config(resolved, plan, trim=trim)
    note = None
    if _repeats_training(target, plan, config):
        other_seed = (plan.seed + 1) % (LARGEST_TRAINING_SEED + 1)
        note = (
            f"the same episodes as at the end of the training, no confirmation: seed={other_seed}"
        )
    execute(config, lambda job: _evaluate(job, plan, note), command_line())


def _repeats_training(target: Target, plan: EvaluationPlan, config: Resolved) -> bool:
    """Whether the evaluation at the end of the training played the same episodes of the policy."""
    if target.run is None or target.file is None:
        return False
    is_last_policy = target.file.name == Path(CHECKPOINT).name
    changing = ("task", "variation")
    is_other_task = any(line.lstrip("+~").startswith(changing) for line in config.overrides)
    if not is_last_policy or is_other_task or not plan.deterministic:
        return False
    summary_file = target.run / SUMMARY
    if not summary_file.is_file():
        return False
    try:
        earlier = json.loads(summary_file.read_text(encoding="utf-8")).get("eval")
    except (OSError, ValueError):  # a damaged summary is no reason not to evaluate
        return False
    if not earlier:
        return False
    return bool(
        plan.seed == earlier.get("seed")
        and plan.episodes == earlier.get("episodes")
        and int(config.tree["num_envs"]) == earlier.get("num_envs")
    )


def _parse_integer(key: str, word: str, *, least: int) -> int:
    with suppress(ValueError):
        value = int(word)
        if value >= least:
            return value
    raise ConfigError([Problem(key, f"must be an integer of at least {least}, got {word!r}")])


def _parse_switch(key: str, word: str) -> bool:
    if word.lower() not in ("true", "false"):
        raise ConfigError([Problem(key, f"must be true or false, got {word!r}")])
    return word.lower() == "true"


def _evaluate(job: Job, plan: EvaluationPlan, note: str | None) -> float | None:
    """Evaluate, write `eval.json` and print the results.

    Args:
        job: The job.
        plan: The options of the evaluation.
        note: A sentence for `run.log` and above the results, or None.

    Returns:
        The objective for a sweeper.
    """
    result = evaluate_job(job, plan)
    if result["complete"]:
        write_evaluation_receipt(job, plan, result)
    result |= job.film(result["log"])
    if note is not None and job.quiet:
        _log.warning(note)  # on stderr, too: nothing is printed below
    elif note is not None:
        _log.info(note)
    if job.root.json:
        print_json(result)
    elif not job.quiet:
        policy, episodes, *rows = evaluation_rows(result)
        if note is not None:
            rows = [("note", note), *rows]
        title = f"{result['task']}  ([low, high]: {result['confidence']:.0%} intervals)"
        print_facts(title, [policy, episodes, *rows])
    return objective_of(result)
