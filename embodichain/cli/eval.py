"""`embodichain eval`: exactly N episodes of a policy, and how far their numbers can be trusted.

Counting is `embodichain.learning.evaluation`'s; this finds the policy and its task, makes a run
folder, and shows what came out.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json, to_json
from embodichain.cli.exits import Interrupted
from embodichain.cli.jobs import COMMAND_VARIABLE, Job, execute, given
from embodichain.cli.stopping import StopFlag
from embodichain.cli.trained import find_target, split_words, take
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.learning.episode_statistics import EpisodeStatistics
    from embodichain.learning.evaluation import Evaluation

__all__ = ["EVAL_FILE", "main"]

EVAL_FILE = "eval.json"
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
        self.episodes = _integer(overrides, "episodes", _EPISODES, least=1)
        word = take(overrides, "deterministic") or "true"
        if word.lower() not in _WORDS:
            raise _wrong("deterministic", f"must be true or false, got {word!r}")
        self.deterministic = _WORDS[word.lower()]
        seed = _integer(overrides, "seed", None, least=0)
        roots = [line.partition("=")[2] for line in overrides if line.startswith("output_dir=")]
        target = find_target(name, roots[-1] if roots else "outputs")
        chosen = any(line.startswith("num_envs=") for line in overrides)
        fresh: dict[str, Any] = {"quiet": False, "json": False, "traceback": False}
        fresh |= {"viewer": {"name": "none"}, "resume": None, "max_steps": None, "video": None}
        fresh |= {"total_timesteps": None, "algo": None, "record": {}, "output_dir": "outputs"}
        if target.run is None and seed is None:
            seed = 0  # the same episodes each time, not drawn anew
        self.resolved, self.seed = self._fill(target.resolve(overrides, fresh), seed, chosen)

    def _fill(self, resolved: Resolved, seed: int | None, chosen: bool) -> tuple[Resolved, int]:
        """Put what the environment is built with into the config that is written."""
        import dataclasses

        from embodichain.config.frozen import freeze
        from embodichain.config.schema import LARGEST_TRAINING_SEED
        from embodichain.learning.evaluation import EVAL_SEED_OFFSET

        tree = dict(resolved.tree)
        if seed is None:
            seed = int(tree["seed"]) % EVAL_SEED_OFFSET
        elif seed > LARGEST_TRAINING_SEED:
            raise _wrong("seed", f"must be from 0 to {LARGEST_TRAINING_SEED}, got {seed}")
        if not chosen:  # more environments than episodes would play for nothing
            tree["num_envs"] = min(tree["num_envs"], self.episodes)
        tree["episodes"] = -(-self.episodes // tree["num_envs"])
        tree["seed"] = EVAL_SEED_OFFSET + seed
        return dataclasses.replace(resolved, tree=freeze(tree)), seed

    def evaluate(self, run: Job, stop: StopFlag) -> float | None:
        """Build, play, write `eval.json`, show it."""
        from embodichain.config.run_folder import write_atomically

        root = run.root
        if not root.quiet and not root.json:
            sys.stderr.write(f"{run.resolved.task_name}: {run.folder}\n")
        found, log = self._play(run, stop)
        result = {
            "task": run.resolved.task_name,
            "policy": root.policy,
            "deterministic": self.deterministic,
            "folder": str(run.folder),
            "log": log,
            **found.as_dict(),
        }
        write_atomically(run.folder / EVAL_FILE, to_json(result, indent=2) + "\n")
        if root.json:
            print_json(result)
        elif not root.quiet:
            _print(result)
        if not found.complete:
            raise Interrupted(f"interrupted ({stop.stopped}); {run.folder} is complete up to there")
        return found.returns.mean if found.returns is not None else None

    def _play(self, run: Job, stop: StopFlag) -> tuple[Evaluation, str | None]:
        """The evaluation from build to close, and where its log is."""
        from embodichain.cli.attach import attach_log
        from embodichain.cli.policies import policy_of
        from embodichain.cli.progress import ProgressDisplay
        from embodichain.config.factory import make_env
        from embodichain.learning.evaluation import evaluate

        root, task = run.root, run.resolved.task_name
        env = make_env(run.resolved, run_dir=run.folder)
        try:
            policy = policy_of(root, env, deterministic=self.deterministic)
            recorder = attach_log(run, env)
            quiet = root.quiet or root.json
            with ProgressDisplay(task, self.episodes, "episodes", quiet=quiet) as display:

                def watch(counted: EpisodeStatistics) -> bool:
                    if display.due or counted.complete:
                        display.show(counted.episodes, _facts(counted))
                    return stop.stopped is not None

                found = evaluate(env, policy, self.episodes, seed=self.seed, watch=watch)
        finally:
            env.close()  # finishes the log too
        return found, str(recorder.stats.path) if recorder is not None else None


def _facts(counted: EpisodeStatistics) -> dict[str, str]:
    facts = {"step": f"{counted.steps}"}
    for name, form in (("return", ".3g"), ("success", ".0%")):
        mean = counted.mean(name)
        if mean is not None:
            facts[name] = format(mean, form)
    return facts


def _print(result: Mapping[str, Any]) -> None:
    """The closing table."""
    from embodichain.cli.tables import print_facts

    mode = "deterministic" if result["deterministic"] else "actions drawn"
    rows: list[tuple[str, Any]] = [
        ("policy", f"{result['policy']} ({mode})"),
        ("episodes", f"{result['episodes']:,} of {result['num_envs']} environments"),
    ]
    success = result["success"]
    if success is not None:
        low, high = success["interval"]
        share = f"{success['rate']:.1%}  [{low:.1%}, {high:.1%}]"
        rows.append(("success", f"{share}  {success['count']} of {success['trials']}"))
    for name, key in (("return", "returns"), ("length", "length")):
        rows += _estimate_rows(name, result[key])
    rows += [(f"reward {name}", value) for name, value in result["rewards"].items()]
    rows += [(f"metric {name}", value) for name, value in result["metrics"].items()]
    rows.append(("terminated", f"{result['terminated']} episodes"))
    rows.append(("diverged", f"{result['diverged']} episodes"))
    rows += [(name, result[name]) for name in ("seed", "log", "folder") if result[name] is not None]
    title = f"{result['task']}  ([low, high]: {result['confidence']:.0%} intervals)"
    print_facts(title, rows)


def _estimate_rows(name: str, found: Mapping[str, Any] | None) -> list[tuple[str, Any]]:
    from embodichain.cli.tables import number

    if found is None:
        return [(name, None)]

    def spread(key: str) -> str:
        interval = found[f"{key}_interval"]
        ends = f"  [{number(interval[0])}, {number(interval[1])}]" if interval is not None else ""
        return f"{number(found[key])}{ends}"

    whole = f"{number(found['min'])} to {number(found['max'])}"
    return [
        (f"{name} mean", spread("mean")),
        (f"{name} IQM", spread("iqm")),
        (f"{name} median", f"{number(found['median'])}  ({whole})"),
    ]


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
