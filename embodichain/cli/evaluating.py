"""An evaluation, as `eval` and the end of `train` do it: play a policy, show what came out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from embodichain.cli.attach import attach_log, attach_viewer, policy_of
from embodichain.cli.output import number, print_facts, to_json
from embodichain.cli.progress import ProgressDisplay
from embodichain.utils.atomic import write_text
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.cli.jobs import Job
    from embodichain.cli.process import StopFlag
    from embodichain.config.resolved import Resolved
    from embodichain.learning.episode_statistics import EpisodeStatistics
    from embodichain.learning.evaluation import Evaluation

__all__ = [
    "EVAL_FILE",
    "Asked",
    "brief_rows",
    "evaluate_job",
    "evaluation_config",
    "objective_of",
    "print_evaluation",
]

EVAL_FILE = "eval.json"


@dataclasses.dataclass(frozen=True, slots=True)
class Asked:
    """What is evaluated.

    Attributes:
        episodes: How many, over all environments.
        seed: As people give it; that of the environments is `EVAL_SEED_OFFSET` higher.
        deterministic: Whether a trained policy takes its mean action.
    """

    episodes: int
    seed: int
    deterministic: bool = True


def evaluation_config(resolved: Resolved, asked: Asked, *, trim: bool = True) -> Resolved:
    """Return the config that an evaluation's environment is built with, as it is written.

    Args:
        resolved: Of what is evaluated.
        asked: How.
        trim: Whether there are at most as many environments as episodes: more would play for
            nothing.

    Raises:
        ConfigError: The log would show environments that the evaluation does not have.
    """
    from embodichain.learning.evaluation import EVAL_SEED_OFFSET

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


def evaluate_job(run: Job, stop: StopFlag, asked: Asked) -> dict[str, Any]:
    """Build, play, log, and write `eval.json` into the run's folder.

    Args:
        run: Its config is one of `evaluation_config`, with the policy to play.
        stop: Its flag ends the evaluation after a whole step: what was played until then counts.
        asked: How.

    Returns:
        What `eval.json` holds.
    """
    found, log, changed = _play(run, stop, asked)
    result = {
        "task": run.resolved.task_name,
        "policy": run.root.policy,
        "deterministic": asked.deterministic,
        "folder": str(run.folder),
        "log": log,
        "changed": changed,
        **found.as_dict(),
    }
    write_text(run.folder / EVAL_FILE, to_json(result, indent=2) + "\n")
    return result


def _play(run: Job, stop: StopFlag, asked: Asked) -> tuple[Evaluation, str | None, list[str]]:
    """The evaluation from build to close, where its log is, and what changed since training."""
    from embodichain.config.factory import make_env
    from embodichain.learning.evaluation import evaluate

    root, task = run.root, run.resolved.task_name
    env = make_env(run.resolved, run_dir=run.folder)
    try:
        policy = policy_of(root, env, deterministic=asked.deterministic)
        recorder = attach_log(run, env)
        attach_viewer(root, env, stop, realtime=False, resets=False)
        with ProgressDisplay(task, asked.episodes, "episodes", quiet=run.quiet) as display:

            def watch(counted: EpisodeStatistics) -> bool:
                if display.due or counted.complete:
                    display.show(counted.episodes, _facts(counted))
                return stop.stopped is not None

            found = evaluate(env, policy, asked.episodes, seed=asked.seed, watch=watch)
    finally:
        env.close()  # finishes the log too
    changed = [str(change) for change in getattr(policy, "changed", ())]
    return found, str(recorder.stats.path) if recorder is not None else None, changed


def _facts(counted: EpisodeStatistics) -> dict[str, str]:
    facts = {"step": f"{counted.steps}"}
    for name, form in (("return", ".3g"), ("success", ".0%")):
        mean = counted.mean(name)
        if mean is not None:
            facts[name] = format(mean, form)
    return facts


def print_evaluation(result: Mapping[str, Any]) -> None:
    """Print the closing table of `eval`.

    Args:
        result: What `eval.json` holds.
    """
    mode = "deterministic" if result["deterministic"] else "actions drawn"
    rows: list[tuple[str, Any]] = [
        ("policy", f"{result['policy']} ({mode})"),
        ("episodes", f"{result['episodes']:,} of {result['num_envs']} environments"),
        *_success_row(result),
    ]
    for name, key in (("return", "returns"), ("length", "length")):
        rows += _estimate_rows(name, result[key])
    rows += [(f"reward {name}", value) for name, value in result["rewards"].items()]
    rows += [(f"metric {name}", value) for name, value in result["metrics"].items()]
    rows.append(("terminated", f"{result['terminated']} episodes"))
    rows.append(("diverged", f"{result['diverged']} episodes"))
    names = ("seed", "log", "video", "folder")
    rows += [(name, result[name]) for name in names if result.get(name) is not None]
    title = f"{result['task']}  ([low, high]: {result['confidence']:.0%} intervals)"
    print_facts(title, rows)


def brief_rows(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return what the closing table of a training says of its evaluation."""
    episodes = f"{result['episodes']:,} episodes  ([low, high]: {result['confidence']:.0%})"
    returns = _estimate_rows("return", result["returns"])[:2]
    rows = [("episodes", episodes), *_success_row(result), *returns]
    return [(f"eval {name}", value) for name, value in rows]


def objective_of(result: Mapping[str, Any]) -> float | None:
    """What a sweeper optimises: the success rate, or the mean return where there is none."""
    if result["success"] is not None:
        return float(result["success"]["rate"])
    return None if result["returns"] is None else float(result["returns"]["mean"])


def _success_row(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    success = result["success"]
    if success is None:
        return []
    low, high = success["interval"]
    share = f"{success['rate']:.1%}  [{low:.1%}, {high:.1%}]"
    return [("success", f"{share}  {success['count']} of {success['trials']}")]


def _estimate_rows(name: str, found: Mapping[str, Any] | None) -> list[tuple[str, Any]]:
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
