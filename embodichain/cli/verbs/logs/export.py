"""`embodichain export`: a log in another program's format; a policy as ONNX or TorchScript."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.jobs.job import describe_early_end, film_progress
from embodichain.cli.jobs.trained import Target, parse_target
from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.cli.terminal.output import print_json, say_warnings
from embodichain.cli.terminal.process import Interrupted, StopFlag, interrupts_say
from embodichain.cli.terminal.reporting import ProgressDisplay, warnings_on_stderr
from embodichain.cli.verb import verb
from embodichain.cli.words import log_of, log_warnings, pair
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.learning.policies.exporting import Format
    from embodichain.recording.export.log_parts import Part
    from embodichain.recording.read.api import Log

__all__ = ["command"]

_POLICY_SUFFIXES: dict[Format, str] = {"onnx": ".onnx", "torchscript": ".pt"}
"""Format of a policy -> the suffix of its file."""
_NOT_WRITTEN = "nothing was written: an export is complete, or there is no file"
_PART_OPTIONS = {
    "env": "env",
    "episode": "episode",
    "from": "start",
    "to": "stop",
    "camera": "cameras",
    "size": "size",
}
"""Flag -> field of `ExportOptions`, for those that choose a part of a log."""


def _log_formats() -> list[str]:
    """Names of the formats of logs, none of which is imported."""
    from embodichain.recording.export.format_register import EPISODE_FORMATS, FORMATS

    return list(dict.fromkeys([*FORMATS.names(), *EPISODE_FORMATS.names()]))


class _FormatOption(click.Option):
    """`--format`, whose help names the formats that are installed."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Look the formats up when help is asked for, not when the verb is imported."""
        logs = ", ".join(_log_formats())
        policies = ", ".join(_POLICY_SUFFIXES)
        self.help = f"For a log: {logs} (`embodichain list formats`); for a policy: {policies}."
        return super().get_help_record(ctx)


def _complete_format(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    formats = [*_log_formats(), *_POLICY_SUFFIXES]
    return [name for name in formats if name.startswith(incomplete)]


def _complete_word(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    return [word for word in ("policy", "last") if word.startswith(incomplete)]


@dataclass(frozen=True)
class ExportOptions:
    """What was typed after `export`.

    Attributes:
        words: Logs, their folders or ``last``; or ``policy``, a policy and overrides.
        form: The format; None is ONNX for a policy.
        output: Path of the new file (lerobot: folder).
        observations: Write the task's observations instead of states.
        group: The observation group; None is ``policy``.
        failures: With observations: write all episodes, not successes only.
        env: Only this environment of the log.
        episode: Only this episode of `env`.
        start: First control step.
        stop: The control step to stop before.
        cameras: Cameras to draw; empty for the task's sensors.
        size: Pixels of the pictures, ``WIDTHxHEIGHT``; None is each camera's own.
        json: Print the result as one JSON object.
    """

    words: tuple[str, ...]
    form: str | None
    output: str | None
    observations: bool
    group: str | None
    failures: bool
    env: int | None
    episode: int | None
    start: int | None
    stop: int | None
    cameras: tuple[str, ...]
    size: str | None
    json: bool


@verb(
    "export",
    ("export last --format csv", "the newest log as a table, beside it"),
    ("export FOLDER --format robomimic", "successes, with the task's observations"),
    ("export FILE --format lerobot --observations", "the same as a LeRobot data set"),
    ("export FILE --format hdf5 -o demos.hdf5", "states, in robomimic's layout"),
    ("export last --format ros2 --env 2 --from 0 --to 100", "a ROS 2 bag of a part"),
    ("export last --format mp4 --camera default --size 320x240", "a film"),
    ("export policy last", "policy.onnx in the run's folder"),
    ("export policy last --format torchscript -o reach.pt", "for C++ and PyTorch"),
    ("export policy my_model.zip task=reach", "a zip of your own"),
    options=ExportOptions,
    config_dir=True,
)
@click.argument(
    "words",
    nargs=-1,
    metavar="FILE|FOLDER|last... | policy RUN|last|PATH [task=NAME]",
    shell_complete=_complete_word,
)
@click.option(
    "--format",
    "form",
    cls=_FormatOption,
    metavar="F",
    shell_complete=_complete_format,
)
@click.option("--output", "-o", metavar="OUT", help="A new file, or folder if the format is one.")
@click.option(
    "--observations",
    is_flag=True,
    help="The task's observations instead of states, where a format has both (lerobot); of "
    "several logs, too.",
)
@click.option("--group", metavar="G", help="The observation group. Default: policy.")
@click.option(
    "--failures", is_flag=True, help="With observations: all episodes, not successes only."
)
@click.option("--env", type=int, metavar="I", help="Only this environment of the log.")
@click.option("--episode", type=int, metavar="K", help="Only this episode of --env.")
@click.option("--from", "start", type=int, metavar="T", help="First control step.")
@click.option("--to", "stop", type=int, metavar="T", help="The control step to stop before.")
@click.option(
    "--camera",
    "cameras",
    multiple=True,
    metavar="NAME",
    help="Formats with pictures: draw this camera; may be repeated. Default: the task's sensors.",
)
@click.option("--size", metavar="WxH", help="Pixels of the pictures. Default: each camera's own.")
def command(options: ExportOptions) -> None:
    """Write a log, or a part of it, or a policy, to a new file."""
    if not options.words:
        raise ConfigError("export what? One of: policy RUN, FILE (a log), last")
    if options.words[0] == "policy":
        _export_policy(options)
    elif options.form is None:
        raise ConfigError(f"--format is needed: {', '.join(_log_formats())}")
    elif _exports_observations(options):
        _export_episodes(options.form, options)
    elif len(options.words) > 1:
        raise ConfigError(f"one log at a time: {', '.join(options.words)}")
    else:
        _export_log(options.form, options)


def _exports_observations(options: ExportOptions) -> bool:
    """Whether the task's observations are exported, not the states of the log.

    Raises:
        ConfigError: Another option does not apply to what is exported.
    """
    from embodichain.recording.export.format_register import EPISODE_FORMATS, FORMATS

    # Formats that have no form with states need no --observations.
    only_episodes = [name for name in EPISODE_FORMATS.names() if name not in FORMATS.names()]
    if options.observations or options.form in only_episodes:
        for flag, name in _PART_OPTIONS.items():
            if getattr(options, name) not in (None, ()):
                message = f"--{flag} does not go with observations: whole episodes are written"
                raise ConfigError(message)
        return True
    for flag in ("group", "failures"):
        if getattr(options, flag):
            formats = ", ".join(only_episodes)
            raise ConfigError(f"--{flag} needs --observations or --format {formats}")
    return False


def _export_episodes(form: str, options: ExportOptions) -> None:
    """Write the episodes of logs with observations; a signal leaves no file."""
    from embodichain.recording.export.episodes import export_episodes

    paths: list[Path] = []
    for word in options.words:
        if word == "last":
            paths.append(log_of(word).parent)
        else:
            paths.append(Path(word))
    num_episodes = 0
    with (
        warnings_on_stderr(),
        ProgressDisplay("export", None, "episodes", quiet=options.json) as display,
    ):

        def progress(episodes: int) -> None:
            nonlocal num_episodes
            num_episodes = episodes
            if display.due:
                display.show(episodes, {})

        with interrupts_say(_NOT_WRITTEN):
            path = export_episodes(
                paths,
                form,
                options.output,
                group=options.group or "policy",
                failures=options.failures,
                progress=progress,
            )
    num_bytes = _count_bytes(path)
    if options.json:
        print_json({"file": str(path), "bytes": num_bytes, "episodes": num_episodes})
    else:
        sys.stdout.write(f"{path}: {num_episodes} episodes, {num_bytes / 1e6:.2f} MB\n")


def _export_policy(options: ExportOptions) -> None:
    """Write a trained policy, and print how far its actions are from the training's."""
    form = _policy_format(options.form or "onnx")
    target, lines = parse_target("export", options.words[1:])
    refuse_unread("export policy", lines)
    if target.file is None or target.file.suffix in _POLICY_SUFFIXES.values():
        message = f"policy: only zips of trainings are exported, not {target.policy}"
        raise ConfigError(message)
    suffix = _POLICY_SUFFIXES[form]
    if options.output is not None:
        out = Path(options.output)
    elif target.run is not None:
        out = target.run / f"policy{suffix}"
    else:  # a file that belongs to no run
        out = target.file.with_suffix(suffix)
    facts = _write_policy(target, lines, out, form)
    if options.json:
        print_json(facts)
    else:
        difference = f"at most {facts['largest_difference']:.2g} from the policy's actions"
        sys.stdout.write(f"{out}: {facts['task']}, {facts['algo']}, {difference}\n")


def _policy_format(name: str) -> Format:
    """The format of a policy that has a name.

    Raises:
        ConfigError: There is no such format.
    """
    for form in _POLICY_SUFFIXES:
        if form == name:
            return form
    raise ConfigError(f"--format of a policy is one of {', '.join(_POLICY_SUFFIXES)}, not {name}")


def _write_policy(target: Target, overrides: list[str], out: Path, form: Format) -> dict[str, Any]:
    """Write a trained policy in the environment of its run, or of ``task=`` in the overrides.

    Returns:
        What `--json` prints.
    """
    from embodichain.config.composition.environment import notes_of_today
    from embodichain.config.environments.factory import make_env
    from embodichain.learning.policies.exporting import export_policy
    from embodichain.learning.policies.policy import load_checkpoint

    root_values = {
        "viewer": {"name": "none"},
        "algo": None,
        "num_envs": 1,
        "resume": None,
        "allow_changed": False,
        "trust": False,
    }
    resolved = target.resolve(overrides, root_values, only_reads=True)
    for note in notes_of_today(resolved.tree):
        sys.stderr.write(f"warning: {note}\n")
    # For the observation columns and the action bounds, which the file has, too.
    env = make_env(resolved)
    try:
        policy = load_checkpoint(Path(target.policy), env, trust=resolved.root.trust)
        policy.allow_changed = resolved.root.allow_changed
        difference = export_policy(policy, env, out, form, task=resolved.task_name)
    finally:
        env.close()
    return {
        "file": str(out),
        "format": form,
        "task": resolved.task_name,
        "algo": policy.algo,
        "policy": target.policy,
        "largest_difference": difference,
    }


def _export_log(form: str, options: ExportOptions) -> None:
    """Write a log, or a part of it, with states.

    Raises:
        ConfigError: The options do not fit together.
        Interrupted: A signal ended a film early, or nothing was written.
    """
    from embodichain.recording.export.format_register import FORMATS
    from embodichain.recording.export.log_parts import Part
    from embodichain.recording.shards import joining

    if options.episode is not None and options.env is None:
        raise ConfigError("--episode needs --env: episodes are counted in each environment")
    size: tuple[int, int] | None = None
    if options.size is not None:
        size = pair("--size", options.size, "WIDTHxHEIGHT in pixels, such as 640x480")
    part = Part(
        env=options.env,
        episode=options.episode,
        start=options.start or 0,
        stop=options.stop,
        cameras=options.cameras or None,
        size=size,
    )
    interruption = ""
    with warnings_on_stderr(), joining.open(log_of(options.words[0]), simulate=True) as log:
        if FORMATS[form].film:
            path, interruption = _film(log, form, part, options)
        else:
            path = _write(log, form, part, options.output)
        say_warnings(log.path, log_warnings(log))
        num_bytes = _count_bytes(path)
        if options.json:
            print_json({"file": str(path), "bytes": num_bytes, "complete": log.complete})
        else:
            sys.stdout.write(f"{path}: {num_bytes / 1e6:.2f} MB\n")
    if interruption:
        raise Interrupted(interruption)


def _write(log: Log, form: str, part: Part, out: str | None) -> Path:
    """Write any format but a video; a signal leaves no file."""
    from embodichain.recording.export.log_export import export

    with interrupts_say(_NOT_WRITTEN):
        return export(log, form, out, part)


def _film(log: Log, form: str, part: Part, options: ExportOptions) -> tuple[Path, str]:
    """Write a video.

    Returns:
        Its path, and a message if a signal ended it early, else empty.

    Raises:
        Interrupted: A signal came before the first picture.
    """
    from embodichain.recording.export.log_export import export
    from embodichain.recording.film.filming import Filmed

    filmed = Filmed(pictures=0, step=-1, whole=False)
    display = ProgressDisplay("film", None, "pictures", quiet=options.json)
    with StopFlag() as stop, display:
        show = film_progress(display)

        def progress(filmed_so_far: Filmed) -> None:
            nonlocal filmed
            filmed = filmed_so_far
            show(filmed_so_far)

        path = export(log, form, options.output, part, progress=progress, stop=stop.is_stopped)
        if not filmed.pictures:
            raise Interrupted(describe_early_end(stop, filmed, path))
        if stop.is_stopped():
            return path, describe_early_end(stop, filmed, path)
        return path, ""


def _count_bytes(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    if path.is_file():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
