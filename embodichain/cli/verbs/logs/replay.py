"""`embodichain replay`: prints, verifies, films or views a log, or replays it with a policy."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.jobs.access_options import AccessOptions, access_options, naming_flags
from embodichain.cli.jobs.job import describe_early_end, film_progress
from embodichain.cli.jobs.watching import Watching
from embodichain.cli.terminal import process
from embodichain.cli.terminal.output import (
    print_facts,
    print_json,
    print_table,
    result_row,
    say_warnings,
)
from embodichain.cli.terminal.process import Interrupted, StopFlag
from embodichain.cli.terminal.reporting import ProgressDisplay, warn_if_public, warnings_on_stderr
from embodichain.cli.verb import log_argument, verb
from embodichain.cli.words import STILL_GOING, is_still_written, log_of, log_warnings, pair
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.recording.format.header import Header
    from embodichain.recording.read.api import Log
    from embodichain.recording.read.episodes import LogEpisode
    from embodichain.recording.read.summary import LogSummary
    from embodichain.recording.viewers.log_player import Screen

__all__ = ["command"]

_COLUMNS = (
    "env",
    "episode",
    "steps",
    "total_reward",
    "terminated",
    "last_step",
    "success",
    "counted",
)
"""Columns of the table of episodes."""
_MOST_EPISODES = 20
_ACTIONS = ("verify", "video", "policy", "view")
"""Options of which one at most is typed: each is another thing to do with the log."""
_ONLY_WITH = {
    "images": ("verify",),
    "speed": ("video", "view"),
    "allow_changed": ("policy",),
    "trust": ("policy",),
    "camera": ("video",),
    "size": ("video",),
    "host": ("view",),
    "port": ("view",),
    "wait_s": ("view",),
    "token": ("view",),
    "allow_hosts": ("view",),
    "allow_origins": ("view",),
}
"""Option -> the actions that read it."""


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(AccessOptions):
    """What was typed after `replay`.

    Attributes:
        file: The log, its folder, or ``last``.
        verify: Simulate again and compare.
        images: With `verify`: also draw the first picture of each episode and compare it.
        env: Only this environment.
        episode: Only this episode, counted from 0.
        start: First control step.
        stop: The control step to stop before.
        speed: Speed of `view` and `video`; 1 is real time.
        policy: Play the same episodes with this policy.
        allow_changed: With `policy`: allow one that was trained in another task.
        trust: With `policy`: run code of its file, if it cannot be read without.
        view: Play it: ``native``, ``web``, or empty for the one that this machine can show.
        host: Address of `view`.
        port: Port of `view`.
        wait_s: Seconds for which `view` waits for the page to be opened; None is 30.
        video: Path of the film to write.
        camera: The camera of the scene that films.
        size: Pixels of the film, ``WIDTHxHEIGHT``.
        quiet: Print no progress and no report.
        json: Print the result as one JSON object.
    """

    file: str
    verify: bool
    images: bool
    env: int | None
    episode: int | None
    start: int | None
    stop: int | None
    speed: float | None
    policy: str | None
    allow_changed: bool | None
    trust: bool | None
    view: str | None
    host: str | None
    port: int | None
    wait_s: float | None
    video: str | None
    camera: str | None
    size: str | None
    quiet: bool
    json: bool

    @property
    def last(self) -> int | None:
        """The last control step, included."""
        if self.stop is None:
            return None
        return self.stop - 1

    @property
    def typed_names(self) -> set[str]:
        """Names of the options that were typed."""
        return {
            name
            for name, value in vars(self).items()
            if value is not None and value is not False and value != ()
        }


@verb(
    "replay",
    ("replay last", "the newest run's log"),
    ("replay last --verify", "simulate it again from the file alone"),
    ("replay last --verify --env 2 --episode 0", "only that environment and episode"),
    ("replay last --env 2 --from 100 --to 200", "list its episodes between these steps"),
    ("replay last --view web", "play it in a browser; --view alone: in a window"),
    ("replay last --policy zero", "the same episodes with another policy, side by side"),
    ("replay last --video film.mp4 --env 2 --speed 0.5", "film it, at half the speed"),
    ("replay outputs/latest/rollout.mcap --json", "what it contains, for scripts"),
    options=ReplayOptions,
    quiet=True,
)
@log_argument()
@click.option("--verify", is_flag=True, help="Simulate again and compare.")
@click.option(
    "--images",
    is_flag=True,
    help="With --verify: also draw the first picture of each episode and compare it.",
)
@click.option("--env", type=int, metavar="I", help="Only this environment.")
@click.option("--episode", type=int, metavar="K", help="Only this episode, counted from 0.")
@click.option("--from", "start", type=int, metavar="T", help="First control step.")
@click.option("--to", "stop", type=int, metavar="T", help="The control step to stop before.")
@click.option(
    "--speed",
    type=click.FloatRange(min=0, min_open=True),
    metavar="X",
    help="Speed of --view and --video; 1 is real time.",
)
@click.option("--policy", metavar="P", help="Play the same episodes with this policy.")
@click.option(
    "--allow-changed",
    is_flag=True,
    default=None,
    help="With --policy: allow one that was trained in another task.",
)
@click.option(
    "--trust",
    is_flag=True,
    default=None,
    help="With --policy: run code of its file, if it cannot be read without.",
)
@click.option(
    "--view",
    is_flag=False,
    flag_value="",
    metavar="[WHERE]",
    help="Play it in a window (native) or a browser (web). Default: native, if there is a display.",
)
@click.option("--host", metavar="H", help="Address of --view web. Default: 127.0.0.1.")
@click.option("--port", type=int, metavar="P", help="Its port. Default: a free one from 8080.")
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(min=0),
    metavar="S",
    help="Seconds that --view web waits to be opened. Default: 30; in a terminal, until a key.",
)
@access_options("--view web")
@click.option(
    "--video",
    metavar="OUT",
    help="Write an MP4 or a GIF of --env. Default: environment 0.",
)
@click.option("--camera", metavar="NAME", help="Film with this camera of the scene.")
@click.option("--size", metavar="WxH", help="Pixels of the film. Default: 640x480.")
def command(options: ReplayOptions) -> int:
    """Print the contents of a log, or verify, film, view or replay it."""
    _check_options(options)
    path = log_of(options.file)
    if options.video is not None:
        return _film(path, Path(options.video), options)
    if options.view is not None:
        return _view(path, options)
    if options.policy is not None:
        return _rerun(path, options.policy, options)
    if options.verify:
        return _verify(path, options)
    return _inspect(path, options)


def _check_options(options: ReplayOptions) -> None:
    """Refuse options that exclude each other, or that nothing would read."""
    typed = options.typed_names
    actions = [name for name in _ACTIONS if name in typed]
    if len(actions) > 1:
        raise ConfigError(
            f"--{actions[0]} and --{actions[1]} exclude each other: give one at a time"
        )
    for name, readers in _ONLY_WITH.items():
        if name in typed and typed.isdisjoint(readers):
            flags = " or ".join(f"--{action}" for action in readers)
            raise ConfigError(f"{_flag(name)} needs {flags}")
    if options.verify and not typed.isdisjoint(("start", "stop")):
        raise ConfigError(
            "--from and --to choose the episodes that are listed; --verify needs every step before"
        )


def _flag(name: str) -> str:
    """The flag of an option, by the name of its field."""
    if name in ("allow_hosts", "allow_origins"):  # flags that may be repeated are singular
        name = name.removesuffix("s")
    name = name.removesuffix("_s")  # the unit
    return f"--{name.replace('_', '-')}"


def _rerun(path: Path, policy: str, options: ReplayOptions) -> int:
    """Play the recorded episodes with another policy; returns the exit code."""
    from embodichain.cli.jobs.replay_policy import Repetition, rerun

    repetition = Repetition(
        policy=policy,
        env=options.env,
        episode=options.episode,
        allow_changed=bool(options.allow_changed),
        trust=bool(options.trust),
    )
    with warnings_on_stderr():
        return rerun(path, repetition, quiet=options.quiet, json=options.json)


def _inspect(path: Path, options: ReplayOptions) -> int:
    """Print what a log contains."""
    from embodichain.recording import inspect

    summary = inspect(path)
    episodes = [episode for episode in summary.episodes if _is_listed(episode, options)]
    is_going = not summary.complete and is_still_written(path)
    say_warnings(path, log_warnings(summary))
    if options.json:
        facts = {
            **asdict(summary),
            "running": is_going,
            "messages": summary.messages,
            "duration_s": summary.duration_s,
            "mean_reward": summary.mean_reward,
            "episodes": [{**_row(episode), "drawn": episode.drawn} for episode in episodes],
        }
        print_json(facts)
    elif not options.quiet:
        _print_summary(summary, episodes, is_going=is_going)
    return process.OK


def _is_listed(episode: LogEpisode, options: ReplayOptions) -> bool:
    """Whether an episode matches --env and --episode and has a step in [--from, --to)."""
    return (
        options.env in (None, episode.env)
        and options.episode in (None, episode.episode)
        and (options.start is None or episode.last_step >= options.start)
        and (options.stop is None or episode.first_step < options.stop)
    )


def _row(episode: LogEpisode) -> dict[str, Any]:
    """A row of the table of episodes."""
    return {name: getattr(episode, name) for name in _COLUMNS}


def _print_summary(summary: LogSummary, episodes: list[LogEpisode], *, is_going: bool) -> None:
    """Print the facts of a log, its channels and the first of the listed episodes."""
    header = summary.header
    started = datetime.fromtimestamp(header.start_ns / 1e9)
    state = "complete" if summary.complete else "INCOMPLETE"
    if is_going:
        state = "not complete yet"
    facts: list[tuple[str, Any]] = [
        ("task", header.task),
        ("recorded", f"{started:%Y-%m-%d %H:%M:%S}, {header.recorded_with}"),
        ("environments", f"{header.num_envs}, seed {header.seed}"),
        ("steps", f"{summary.steps} control steps = {summary.duration_s:.2f} s simulated"),
        ("episodes ended", _count_episodes(summary)),
        ("mean return", summary.mean_reward),
        ("file", f"{state}, {summary.nbytes / 1e6:.2f} MB, {summary.messages} messages"),
        ("attachments", list(summary.attachments)),
        ("verifiable", _describe_verification(header)),
    ]
    print_facts(str(summary.path), result_row(dict(facts)).items())
    print_table("channels", [asdict(channel) for channel in summary.channels])
    print_table("episodes", [result_row(_row(episode)) for episode in episodes[:_MOST_EPISODES]])
    if len(episodes) > _MOST_EPISODES:
        sys.stdout.write(f"... and {len(episodes) - _MOST_EPISODES} more: --env, --json\n")


def _count_episodes(summary: LogSummary) -> str:
    """How many episodes ended, and how many of them count."""
    num_ended = len(summary.episodes)
    if summary.counted is None:
        return str(num_ended)
    return f"{num_ended}, of which {summary.counted} count"


def _describe_verification(header: Header) -> str:
    """Whether `--verify` can compare the log here, and how exactly."""
    import mujoco

    obstacle = header.unverifiable or header.unknown_engine
    if obstacle:
        return f"no: {obstacle}"
    if header.mujoco_version != mujoco.__version__:
        return f"not to the bit: this is MuJoCo {mujoco.__version__}; states can be played"
    if header.is_exact:
        return "yes"
    physics = f"physics of {header.engine} within a tolerance"
    if header.has_writes:
        return f"writes and resets to the bit, {physics}"
    return f"{physics}; resets and events are not in the log"


def _verify(path: Path, options: ReplayOptions) -> int:
    """Simulate a log again and print whether every bit is the same; returns the exit code."""
    from embodichain.recording import verify

    quiet = options.quiet or options.json
    with ProgressDisplay("verify", None, "steps", quiet=quiet) as display:

        def progress(steps: int) -> None:
            if display.due:
                display.show(steps, {})

        report = verify(
            path,
            env=options.env,
            episode=options.episode,
            progress=progress,
            images=options.images,
        )
    has_no_difference = report.difference is None and not report.ok
    is_going = has_no_difference and is_still_written(path)
    if options.json:
        print_json({**asdict(report), "running": is_going})
    elif is_going:
        so_far = f"{report.steps} steps so far do not differ" if report.steps else "no step is read"
        sys.stderr.write(f"{path}: {STILL_GOING}: verify its log when it has ended ({so_far})\n")
    elif not report.ok:
        sys.stderr.write(f"{path}: {report}\n")
    elif not options.quiet:
        sys.stdout.write(f"{report}\n")
    return process.OK if report.ok else process.FAILED


def _film(path: Path, out: Path, options: ReplayOptions) -> int:
    """Write the video and print its path; returns the exit code.

    Raises:
        Interrupted: A signal ended the film early.
    """
    from embodichain.recording.film.filming import film_log
    from embodichain.recording.shards import joining

    size = pair("--size", options.size or "640x480", "WIDTHxHEIGHT in pixels, such as 640x480")
    quiet = options.quiet or options.json
    display = ProgressDisplay("film", None, "pictures", quiet=quiet)
    with joining.open(path) as log, StopFlag() as stop, display:
        filmed = film_log(
            log,
            out,
            env=options.env or 0,
            episode=options.episode,
            first=options.start,
            last=options.last,
            speed=options.speed or 1.0,
            size=size,
            camera=options.camera,
            progress=film_progress(display),
            stop=stop.is_stopped,
        )
        say_warnings(log.path, log_warnings(log))
    if filmed.pictures:
        num_bytes = out.stat().st_size
        if options.json:
            facts = {
                "file": str(out),
                "pictures": filmed.pictures,
                "bytes": num_bytes,
                "complete": filmed.whole,
            }
            print_json(facts)
        elif not options.quiet:
            sys.stdout.write(f"{out}: {filmed.pictures} pictures, {num_bytes / 1e6:.2f} MB\n")
    if not (filmed.pictures and filmed.whole):
        raise Interrupted(describe_early_end(stop, filmed, out))
    return process.OK


def _view(path: Path, options: ReplayOptions) -> int:
    """Play until the page or the window is closed, or Ctrl-C is pressed.

    Where nobody sits at a terminal it is played once.
    """
    from embodichain.recording.read.playback import Stretch
    from embodichain.recording.shards import joining
    from embodichain.recording.viewers.log_player import play_log

    stretch = Stretch(
        env=options.env or 0,
        episode=options.episode,
        first=options.start,
        last=options.last,
    )
    with StopFlag() as stop, joining.open(path) as log:
        stretch.span_in(log)  # a mistake is reported before a window opens
        say_warnings(log.path, log_warnings(log))
        screen = _open_screen(log, options, stop)
        watching = _watching(screen, options, stop)
        try:
            if not watching.wait():
                return process.OK
            play_log(
                log,
                screen,
                episode=options.episode,
                first=options.start,
                last=options.last,
                speed=options.speed or 1.0,
                stopped=lambda: stop.is_stopped() or watching.has_lost_all(),
                repeats=watching.has_person,
            )
        finally:
            screen.close()
    return process.OK


def _watching(screen: Screen, options: ReplayOptions, stop: StopFlag) -> Watching:
    """Return what waits for those who look at the log."""
    from embodichain.recording.viewers.log_player import NativeScreen
    from embodichain.recording.viewers.showing import Audience

    audience = Audience(is_watched=lambda: screen.watched)
    if isinstance(screen, NativeScreen):
        audience = Audience(is_watched=lambda: screen.is_open, what="the window", may_return=False)
    wait_s = 30.0 if options.wait_s is None else options.wait_s
    return Watching(audience, wait_s=wait_s, stop=stop, quiet=options.quiet, only_shows=True)


def _open_screen(log: Log, options: ReplayOptions, stop: StopFlag) -> Screen:
    """Open the window or the page that shows the log.

    Raises:
        ConfigError: There is no such view, or it does not read one of the options.
    """
    from embodichain.recording.viewers.log_player import NativeScreen
    from embodichain.utils.system.display import has_display

    env = options.env or 0
    name = options.view
    if not name:
        name = "native" if has_display() else "web"
    if name == "foxglove":
        raise ConfigError("Foxglove and Lichtblick play the file itself: embodichain view FILE")
    if name not in ("native", "web"):
        raise ConfigError(f"--view {name}: there are native, web")
    if name == "native":
        if options.host is not None or options.port is not None:
            raise ConfigError("--host and --port are for --view web")
        if options.wait_s is not None:
            raise ConfigError("--wait is for --view web: a window need not be opened")
        if options.token is not None or options.allow_hosts or options.allow_origins:
            raise ConfigError("--token, --allow-host and --allow-origin are for --view web")
        return NativeScreen(env, stop.is_stopped)
    from embodichain.recording.viewers.page.web_page import PageOptions, WebPage

    host = options.host or "127.0.0.1"
    page_options = PageOptions(
        host=host,
        port=options.port,
        env_id=env,
        resets=False,
        title=f"{log.task}: {log.path.name}",
        access=options.access,
    )
    with naming_flags():
        page = WebPage(log.model, page_options, num_envs=log.num_envs, stopped=stop.is_stopped)
    if not options.quiet or page.url != page.address:  # the URL has a token that must be shown
        sys.stderr.write(f"viewer: {page.url}\n")
        sys.stderr.flush()
    warn_if_public(host, page.url, controls=True)
    return page
