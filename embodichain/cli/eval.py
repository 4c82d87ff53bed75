"""`embodichain eval`: exactly N episodes of a policy, and how far their numbers can be trusted."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

from embodichain.cli.app import common, job_options, overrides, typed, verb
from embodichain.cli.attach import check_attachments, film_job
from embodichain.cli.evaluating import (
    Asked,
    evaluate_job,
    evaluation_config,
    objective_of,
    print_evaluation,
)
from embodichain.cli.exits import Interrupted
from embodichain.cli.jobs import FRESH, Job, execute
from embodichain.cli.output import print_json
from embodichain.cli.process import StopFlag
from embodichain.cli.trained import one_target, take
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["command"]

_EPISODES = 100
_WORDS = {"true": True, "false": False}


@verb(
    "eval",
    ("eval last", "the newest training, 100 episodes"),
    ("eval outputs/latest episodes=500 seed=7", "more of them, others"),
    ("eval last deterministic=false", "actions drawn as in training"),
    ("eval policy.onnx task=reach", "a file, in a task"),
    ("eval random task=reach episodes=50 record=none", "what chance reaches, without a log"),
    keys=True,
)
@overrides("RUN|last|PATH [task=NAME] [KEY=VALUE]...", "last")
@common(config_dir=True, quiet=True)
def command(**kwargs: Any) -> None:
    """Evaluate one policy in a new run folder."""
    from embodichain.config.hydra_loader import user_configs
    from embodichain.config.schema import LARGEST_TRAINING_SEED
    from embodichain.learning.evaluation import EVAL_SEED_OFFSET

    options = SimpleNamespace(**kwargs)
    with user_configs(options.config_dir):
        target, lines = one_target("evaluate", options.words)
        episodes = _integer(lines, "episodes", _EPISODES, least=1)
        word = take(lines, "deterministic") or "true"
        if word.lower() not in _WORDS:
            raise _wrong("deterministic", f"must be true or false, got {word!r}")
        seed = _integer(lines, "seed", None, least=0)
        chosen = any(line.startswith("num_envs=") for line in lines)
        fresh = {**FRESH, "viewer": {"name": "none"}, "record": {}}
        resolved = target.resolve([*lines, *job_options(options)], fresh)
        if seed is None:  # the training's; without a training the same episodes each time
            seed = int(resolved.tree["seed"]) % EVAL_SEED_OFFSET if target.run is not None else 0
        if seed > LARGEST_TRAINING_SEED:
            raise _wrong("seed", f"must be from 0 to {LARGEST_TRAINING_SEED}, got {seed}")
        asked = Asked(episodes, seed, _WORDS[word.lower()])

        def evaluate(run: Job, stop: StopFlag) -> float | None:
            return _evaluate(run, stop, asked)

        execute(evaluation_config(resolved, asked, trim=not chosen), evaluate, typed())


def _evaluate(run: Job, stop: StopFlag, asked: Asked) -> float | None:
    """Play, write `eval.json`, show it."""
    if not run.quiet:
        sys.stderr.write(f"{run.resolved.task_name}: {run.folder}\n")
    check_attachments(run.root)
    result = evaluate_job(run, stop, asked)
    result |= film_job(run, stop, result["log"])
    if run.root.json:
        print_json(result)
    elif not run.quiet:
        print_evaluation(result)
    if stop.stopped is not None:
        raise Interrupted(f"interrupted ({stop.stopped}); {run.folder} is complete up to there")
    return objective_of(result)


def _integer(overrides: list[str], key: str, default: int | None, *, least: int) -> Any:
    word = take(overrides, key)
    if word is None:
        return default
    try:
        value = int(word)
    except ValueError:
        value = least - 1
    if value < least:
        raise _wrong(key, f"must be an integer of at least {least}, got {word!r}")
    return value


def _wrong(key: str, why: str) -> ConfigError:
    return ConfigError([Problem(key, why)])
