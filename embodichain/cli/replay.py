"""`embodichain replay`: what a log holds; with --verify, whether physics agrees with every bit."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli import exits, replay_video, replay_view
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.log_files import log_of
from embodichain.cli.tables import print_facts, print_table
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.recording.header import Header
    from embodichain.recording.summary import Episode, LogSummary
    from embodichain.recording.verification import VerifyReport

__all__ = ["main"]

_MOST_EPISODES = 20
_ACTIONS = ("verify", "video", "policy", "view")
_ONLY_WITH = {
    "speed": ("video", "view"),
    "allow-changed": ("policy",),
    "camera": ("video",),
    "size": ("video",),
    "host": ("view",),
    "port": ("view",),
}


def main(arguments: list[str]) -> int:
    """Print what is in a log, or verify it."""
    parser = VerbParser(VERBS["replay"])
    parser.add_argument("file", metavar="FILE", help="a log, a run's folder, or `last`")
    parser.add_argument("--verify", action="store_true", help="simulate again and compare")
    parser.add_argument("--env", type=int, metavar="I", help="only this environment")
    parser.add_argument("--episode", type=int, metavar="K", help="only this episode, from 0")
    parser.add_argument("--from", dest="start", type=int, metavar="T", help="first control step")
    parser.add_argument("--to", dest="stop", type=int, metavar="T", help="step that ends it")
    parser.add_argument(
        "--speed", type=float, metavar="X", help="of --view and --video; 1 is real time"
    )
    parser.add_argument("--policy", metavar="P", help="play its episodes with this policy instead")
    parser.add_argument(
        "--allow-changed",
        action="store_true",
        default=None,
        help="of --policy: also one trained in a task that is another than the log's",
    )
    replay_view.add_arguments(parser)
    replay_video.add_arguments(parser)
    parser.add_argument("--quiet", "-q", action="store_true", help="no progress, no report")
    add_common(parser)
    options = parser.parse(arguments)
    _check_together(options)
    path = log_of(options.file)
    if options.video is not None:
        return replay_video.film(path, options)
    if options.view is not None:
        return replay_view.view(path, options)
    if options.policy is not None:
        from embodichain.cli.replay_policy import rerun

        return rerun(path, options)
    if options.verify and (options.start, options.stop) != (None, None):
        raise ConfigError("--from and --to choose what is listed; --verify needs every step before")
    return _verify(path, options) if options.verify else _inspect(path, options)


def _check_together(options: argparse.Namespace) -> None:
    """Refuse options that would do nothing."""
    what = [name for name in _ACTIONS if getattr(options, name) not in (None, False)]
    if len(what) > 1:
        raise ConfigError(f"--{what[0]} and --{what[1]} are two things: ask for one at a time")
    for name, actions in _ONLY_WITH.items():
        if getattr(options, name.replace("-", "_")) is not None and not set(actions) & set(what):
            raise ConfigError(f"--{name} needs {' or '.join(f'--{a}' for a in actions)}")


def _inspect(path: Path, options: argparse.Namespace) -> int:
    from embodichain.recording import inspect

    summary = inspect(path)
    episodes = [e for e in summary.episodes if _is_wanted(e, options)]
    for warning in summary.warnings:
        sys.stderr.write(f"warning: {path}: {warning}\n")
    if options.json:
        print_json(_summary_data(summary, episodes))
    elif not options.quiet:
        _print_summary(summary, episodes)
    return exits.OK


def _is_wanted(episode: Episode, options: argparse.Namespace) -> bool:
    """Whether it is the environment's, the episode, and has a step in [--from, --to)."""
    right_env = options.env is None or episode.env == options.env
    right_episode = options.episode is None or episode.episode == options.episode
    first = episode.last_step - episode.steps + 1
    after = options.start is None or episode.last_step >= options.start
    return right_env and right_episode and after and (options.stop is None or first < options.stop)


def _summary_data(summary: LogSummary, episodes: list[Episode]) -> dict[str, Any]:
    return {
        **{name: value for name, value in asdict(summary).items() if name != "episodes"},
        "messages": summary.messages,
        "duration_s": summary.duration_s,
        "mean_reward": summary.mean_reward,
        "episodes": [asdict(episode) for episode in episodes],
    }


def _print_summary(summary: LogSummary, episodes: list[Episode]) -> None:
    header = summary.header
    started = datetime.fromtimestamp(header.start_ns / 1e9)
    state = "complete" if summary.complete else "INCOMPLETE"
    facts: list[tuple[str, Any]] = [
        ("task", header.task),
        ("recorded", f"{started:%Y-%m-%d %H:%M:%S}, MuJoCo {header.mujoco_version}"),
        ("environments", f"{header.num_envs}, seed {header.seed}"),
        ("steps", f"{summary.steps} control steps = {summary.duration_s:.2f} s simulated"),
        ("episodes ended", f"{len(summary.episodes)}"),
        ("mean return", summary.mean_reward),
        ("file", f"{state}, {summary.nbytes / 1e6:.2f} MB, {summary.messages} messages"),
        ("attachments", list(summary.attachments)),
        ("verifiable", _verifiable(header)),
    ]
    print_facts(str(summary.path), facts)
    print_table("channels", [asdict(channel) for channel in summary.channels])
    print_table("episodes", [asdict(episode) for episode in episodes[:_MOST_EPISODES]])
    if len(episodes) > _MOST_EPISODES:
        sys.stdout.write(f"... and {len(episodes) - _MOST_EPISODES} more: --env, --json\n")


def _verifiable(header: Header) -> str:
    import mujoco

    if header.unverifiable:
        return f"no: {header.unverifiable}"
    if header.mujoco_version != mujoco.__version__:
        return f"not to the bit: this is MuJoCo {mujoco.__version__}; states can be played"
    return "yes"


def _verify(path: Path, options: argparse.Namespace) -> int:
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.recording import verify

    quiet = options.quiet or options.json
    with ProgressDisplay("verify", None, "steps", quiet=quiet) as display:

        def progress(steps: int) -> None:
            if display.due:
                display.show(steps, {})

        report = verify(path, options.env, options.episode, progress=progress)
    if options.json:
        print_json(asdict(report))
    elif not options.quiet or not report.ok:
        _print_report(report)
    return exits.OK if report.ok else exits.FAILED


def _print_report(report: VerifyReport) -> None:
    """One line when all is well, else what differs first and what else is wrong."""
    what = f"{report.steps} control steps of {report.envs} environments"
    if report.ok:
        sys.stdout.write(f"verified: {what}, every bit as recorded\n")
        for note in report.notes:
            sys.stderr.write(f"warning: {report.path}: {note}\n")
        return
    sys.stderr.write(f"NOT verified: {report.path}, {what} compared\n")
    if report.difference is not None:
        sys.stderr.write(f"  first difference: {report.difference}\n")
    for problem in report.problems:
        sys.stderr.write(f"  {problem}\n")
    for name, error in report.largest_error.items():
        sys.stderr.write(f"  largest error of {name}: {error:.3g}\n")
    for note in report.notes:
        sys.stderr.write(f"  {note}\n")
