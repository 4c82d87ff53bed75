"""`embodichain eval`: exactly N episodes of a policy, and how far their numbers can be trusted.

Playing is `evaluating.py`'s, the table `evaluated.py`'s; this finds the policy and its task, and
makes a run folder.
"""

from __future__ import annotations

import os
import shlex
import sys
from typing import TYPE_CHECKING, Any

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.evaluating import Asked, evaluate_job, evaluation_config
from embodichain.cli.exits import Interrupted
from embodichain.cli.filming import check_film, film_job
from embodichain.cli.jobs import COMMAND_VARIABLE, Job, execute, given
from embodichain.cli.stopping import StopFlag
from embodichain.cli.trained import find_target, split_words, take
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = ["main"]

_EPISODES = 100
_WORDS = {"true": True, "false": False}


def main(arguments: list[str]) -> int:
    """Evaluate one policy in a new run folder."""
    parser = VerbParser(VERBS["eval"])
    parser.add_argument("words", nargs="*", metavar="RUN|last|PATH|key=value", help="what to play")
    parser.add_argument("--quiet", "-q", action="store_true", help="no progress, no table")
    add_common(parser, config_dir=True)
    options = parser.parse(arguments)
    names, overrides = split_words(options.words)
    if len(names) != 1:
        raise ConfigError("evaluate what? One of: RUN (a training's folder), last, PATH (a policy)")
    flags = [f"{name}=true" for name in ("quiet", "json", "traceback") if getattr(options, name)]
    os.environ[COMMAND_VARIABLE] = shlex.join(["embodichain", "eval", *arguments])
    from embodichain.config.search_path import user_configs

    with user_configs(options.config_dir):
        plan = _Plan(names[0], [*overrides, *flags])
        with given(plan.resolved):
            execute("run", plan.evaluate)
    return exits.OK


class _Plan:
    """What is evaluated and how, checked before anything is made.

    Args:
        name: The policy, as typed.
        overrides: Of its config; ``episodes``, ``deterministic`` and ``seed`` are ours.
    """

    def __init__(self, name: str, overrides: list[str]) -> None:
        episodes = _integer(overrides, "episodes", _EPISODES, least=1)
        word = take(overrides, "deterministic") or "true"
        if word.lower() not in _WORDS:
            raise _wrong("deterministic", f"must be true or false, got {word!r}")
        deterministic = _WORDS[word.lower()]
        seed = _integer(overrides, "seed", None, least=0)
        roots = [line.partition("=")[2] for line in overrides if line.startswith("output_dir=")]
        target = find_target(name, roots[-1] if roots else "outputs")
        chosen = any(line.startswith("num_envs=") for line in overrides)
        fresh: dict[str, Any] = {"quiet": False, "json": False, "traceback": False}
        fresh |= {"viewer": {"name": "none"}, "resume": None, "max_steps": None, "video": None}
        fresh |= {"allow_changed": False}
        fresh |= {"total_timesteps": None, "algo": None, "record": {}, "output_dir": "outputs"}
        if target.run is None and seed is None:
            seed = 0  # the same episodes each time, not drawn anew
        resolved = target.resolve(overrides, fresh)
        self.asked = Asked(episodes, self._seed(resolved, seed), deterministic)
        self.resolved = evaluation_config(resolved, self.asked, trim=not chosen)

    def _seed(self, resolved: Resolved, seed: int | None) -> int:
        """The seed that was asked for, else the training's."""
        from embodichain.config.schema import LARGEST_TRAINING_SEED
        from embodichain.learning.evaluation import EVAL_SEED_OFFSET

        if seed is None:
            return int(resolved.tree["seed"]) % EVAL_SEED_OFFSET
        if seed > LARGEST_TRAINING_SEED:
            raise _wrong("seed", f"must be from 0 to {LARGEST_TRAINING_SEED}, got {seed}")
        return seed

    def evaluate(self, run: Job, stop: StopFlag) -> float | None:
        """Play, write `eval.json`, show it."""
        from embodichain.cli.evaluated import objective_of, print_evaluation

        root = run.root
        if not root.quiet and not root.json:
            sys.stderr.write(f"{run.resolved.task_name}: {run.folder}\n")
        check_film(run)
        result = evaluate_job(run, stop, self.asked)
        result |= film_job(run, stop, result["log"])
        if root.json:
            print_json(result)
        elif not root.quiet:
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
