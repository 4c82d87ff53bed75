"""A job: one run or training, from the command line to its folder, log, policy and viewer.

A single job is composed with Hydra's compose API and executed here. Sweeps, ``--cfg`` and
``--info`` go through Hydra's own `main`, see `embodichain.cli.sweeps.sweeping`.
"""

from __future__ import annotations

import logging
import os
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli.jobs.unread_keys import unread_keys
from embodichain.cli.jobs.watching import Watching
from embodichain.cli.terminal.last import announce_last, replace_last, resolve_links
from embodichain.cli.terminal.process import Interrupted, StopFlag, end_startup
from embodichain.cli.terminal.reporting import ProgressDisplay, log_to, warn_if_public
from embodichain.cli.verb import command_line
from embodichain.cli.words import split_overrides
from embodichain.config.keys.viewers import NO_VIEWER, VIEWERS
from embodichain.config.run_folder import LOG
from embodichain.lab.gym.policies import Policy, resolve_policy
from embodichain.utils.errors import ConfigError, Problem, RenderError
from embodichain.utils.notes import warn_once
from embodichain.utils.system import platforms
from embodichain.utils.system.platforms import LIMITED

if TYPE_CHECKING:
    from embodichain.cli.verb import JobOptions, OverrideOptions
    from embodichain.config.composition.composed import Composed
    from embodichain.config.keys.schema import JobVerb, RootCfg
    from embodichain.config.resolved import Checked, Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.compiler.compile_scene import CompiledScene
    from embodichain.recording import ImageOptions, McapRecorder
    from embodichain.recording.film.filming import Filmed
    from embodichain.recording.shards.shard_logs import ShardLogs
    from embodichain.recording.viewers.showing import Shown

__all__ = [
    "FRESH",
    "Job",
    "Work",
    "check_extras",
    "check_job",
    "describe_early_end",
    "execute",
    "film_progress",
    "output_overrides",
    "pin_last",
    "policy_name",
    "policy_of",
    "resolve_job",
    "start",
]

LOG_FILE = "run.log"
VIDEO = "rollout"
"""Name of the film in a run folder, without its suffix."""
_SAY_AFTER = 1.0
"""Seconds after which a film says how long it takes."""
FRESH: dict[str, Any] = {
    "quiet": False,
    "json": False,
    "traceback": False,
    "resume": None,
    "allow_changed": False,
    "trust": False,
    "max_steps": None,
    "video": None,
    "total_timesteps": None,
    "algo": None,
    "dataset": None,
    "output_dir": "outputs",
}
"""Root keys of a run's config that do not carry over to another run of it."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Job:
    """One run or training.

    Attributes:
        resolved: The config.
        compiled_scene: Its scene, for every environment of the job; None if a class adds to it.
        folder: The run folder, not shared with other runs.
        stop: Set by a signal; the job then ends after the current control step.
        in_sweep: Whether it is a job of a sweep: its viewer does not wait for a browser.
        began: Set by `begin`: all is built, and the folder stays.
        announced: Set by `announce`: the folder was printed.
    """

    resolved: Resolved
    compiled_scene: CompiledScene | None
    folder: Path
    stop: StopFlag
    in_sweep: bool = False
    began: threading.Event = field(default_factory=threading.Event)
    announced: threading.Event = field(default_factory=threading.Event)

    def begin(self) -> None:
        """Declare that all is built: from now on the folder stays, whatever happens."""
        self.announce()
        self.began.set()
        end_startup()

    def announce(self) -> None:
        """Print where the job writes, once. A job that is refused has no folder."""
        if not self.announced.is_set() and not self.quiet:
            sys.stderr.write(f"{self.resolved.task_name}: {self.folder}\n")
        self.announced.set()

    @property
    def root(self) -> RootCfg:
        """The config as data classes."""
        return self.resolved.root

    @property
    def quiet(self) -> bool:
        """Whether only the result is printed."""
        return self.root.quiet or self.root.json

    @property
    def images(self) -> ImageOptions | None:
        """The pictures of `record.images`."""
        from embodichain.recording import ImageOptions

        images = self.root.record.images
        return None if images is None else ImageOptions(**vars(images))

    def attach_log(
        self, env: BaseEnv, name: str = LOG, *, quota: Sequence[int] | None = None
    ) -> McapRecorder | ShardLogs | None:
        """Attach the log unless `record.format` is ``none``; closing the environment closes it.

        Args:
            env: The environment; a batch in shards has a log for each shard.
            name: File name in the folder.
            quota: (N,) how many episodes of each environment count; None if they are listed.
        """
        if self.root.record.format == "none":
            return None
        from embodichain.config.resolved import dump_yaml
        from embodichain.recording import McapRecorder, RecordOptions
        from embodichain.recording.write.kept import kept_in_model

        local_env: BaseEnv = getattr(env, "template", env)  # a batch in shards has no model here
        for sentence in kept_in_model(self.resolved.tree, local_env.sim.engine.model):
            _log.warning("%s", sentence)
        record = self.root.record
        options = {field.name: getattr(record, field.name) for field in fields(RecordOptions)}
        options["images"] = self.images
        metadata: dict[str, Any] = {
            "overrides": dump_yaml(list(self.resolved.overrides)),
            "options": RecordOptions(**options),
            "task": self.resolved.task_name,
            "policy": self.resolved.record({"policy": policy_name(self.root)})["policy"],
            "quota": quota,
        }
        path = self.folder / name
        if self.root.sim.backend == "ray":
            from embodichain.cli.jobs.sharding import attach_logs

            return attach_logs(self.resolved, env, path, metadata)
        recorder = McapRecorder(
            path,
            env,
            config=dump_yaml(self.resolved.tree),
            lists_counted=quota is None,
            **metadata,
        )
        env.add_observer(recorder)
        return recorder

    def attach_viewer(
        self,
        env: BaseEnv,
        policy: Policy | None = None,
        *,
        realtime: bool = True,
        resets: bool = True,
    ) -> Shown | None:
        """Attach the viewer that the config names; closing the environment closes it.

        Args:
            env: The environment.
            policy: The policy that acts in it; a person who teleoperates does it at the viewer.
            realtime: Whether the run starts in real time while a viewer is connected.
            resets: Whether the viewer may end an episode.

        Returns:
            What the viewer has started, if it says so.
        """
        cfg = self.root.viewer
        teleop = None
        if policy_name(self.root) == "teleop":
            from embodichain.lab.gym.teleop import Teleop

            if isinstance(policy, Teleop):
                teleop = policy
                teleop.bind(env)
                realtime = True
        if cfg.name == NO_VIEWER:
            return None
        from embodichain.recording.viewers.showing import Viewing

        viewer = VIEWERS[cfg.name]
        shown: Shown | None = viewer.show(
            Viewing(
                env=env,
                cfg=cfg,
                access=self.resolved.access,
                stopped=self.stop.is_stopped,
                realtime=realtime,
                resets=resets,
                teleop=teleop,
                view_envs=self.root.record.view_envs,
                images=self.images,
                title=self.resolved.task_name,
            )
        )
        if shown is None or not shown.url:
            return shown
        note = f" ({shown.how})" if shown.how else ""
        _log.info("viewer: %s%s", shown.address, note)  # without the token, which is in the URL
        self.announce()
        # Nobody can open the viewer without the token: a URL with one is always printed.
        if not self.quiet or shown.url != shown.address:
            sys.stderr.write(f"viewer: {shown.url}{note}\n")
        warn_if_public(cfg.host, shown.url, controls=viewer.controls)
        return shown

    def watching(self, shown: Shown | None) -> Watching | None:
        """Return what waits for those who look at the viewer; None if nobody is waited for.

        A person who teleoperates is waited for by the policy, with each episode.

        Args:
            shown: What `attach_viewer` returned.
        """
        if shown is None or shown.audience is None or self.in_sweep:
            return None
        if policy_name(self.root) == "teleop":
            return None
        return Watching(
            shown.audience, wait_s=self.root.viewer.wait_s, stop=self.stop, quiet=self.quiet
        )

    def film(self, log: str | Path | None) -> dict[str, str]:
        """Render the log to a video if `video` is set; call it after everything else is written.

        Args:
            log: The closed log, or None.

        Returns:
            ``{"video": PATH}``, or an empty dict without a video. A signal ends the video after
            the current picture, with a warning.

        Raises:
            RenderError: This machine cannot render.
        """
        if not self.root.video or log is None:
            return {}
        from embodichain.config.keys.schema import VideoCfg
        from embodichain.recording.film.filming import film_log
        from embodichain.utils.system.video import GIF, film_suffix

        cfg = self.root.video
        if not isinstance(cfg, VideoCfg):  # video=true
            cfg = VideoCfg()
        out = self.folder / f"{VIDEO}{film_suffix(cfg.format)}"
        if cfg.format is None and out.suffix == GIF:
            _log.info("the film is a GIF; for MP4: pip install 'embodichain[video]'")
        with ProgressDisplay("film", None, "pictures", quiet=self.quiet) as display:
            filmed = film_log(
                log,
                out,
                size=(cfg.size[0], cfg.size[1]),
                progress=film_progress(display),
                stop=self.stop.is_stopped,
                every=cfg.every,
                max_seconds=cfg.max_seconds,
            )
        if filmed.whole:
            _log.info("%s: %d pictures", out, filmed.pictures)
        else:
            _log.warning("%s", describe_early_end(self.stop, filmed, out))
        if not filmed.pictures:
            return {}
        return {"video": str(out)}


Work = Callable[[Job], float | None]
"""The work of a job; returns the objective for a sweeper, or None."""


def start(verb: JobVerb, work: Work, options: JobOptions) -> None:
    """Run one job, or pass the command line to Hydra's `main`.

    The config of every job is checked before the first starts.

    Args:
        verb: The verb with the root config of its name.
        work: The work of a job.
        options: Options of the command line.

    Raises:
        ConfigError: Wrong flags, or mistakes in the config of any job; no job was started.
    """
    from embodichain.config.composition.composed import compose
    from embodichain.config.composition.override_text import readable
    from embodichain.config.resolved import compile_scene_of

    overrides = [*map(readable, split_overrides(options.words)), *output_overrides(options)]
    if options.gym_config is not None:
        from embodichain.config.composition.gym_config import override_of

        overrides.append(override_of(options.gym_config))
    # Read here: the workers of a sweep are not called by this command line.
    execute_job = partial(execute, work=work, command=command_line(), verb=verb)

    def check(job_overrides: Sequence[str]) -> Resolved:
        """Check a job of Hydra's, which is resolved and compiled again where it runs."""
        resolved = resolve_job(compose(job_overrides, verb), verb)
        compile_scene_of(resolved)
        return resolved

    if _needs_hydra(options, overrides):
        from embodichain.cli.sweeps.sweeping import call_hydra

        call_hydra(verb, check, execute_job, options, overrides=overrides)
    else:
        execute_job(resolve_job(compose(overrides, verb), verb))


def _needs_hydra(options: JobOptions, overrides: Sequence[str]) -> bool:
    """Whether Hydra's own `main` is called: for sweeps, for its output, for keys of its own."""
    if options.multirun or options.cfg is not None or options.info is not None:
        return True
    return any(override.lstrip("+~").startswith(("hydra.", "hydra/")) for override in overrides)


def output_overrides(options: OverrideOptions) -> list[str]:
    """Return `--quiet`, `--json` and `--traceback` as overrides.

    The workers of a sweep receive overrides only.
    """
    overrides = []
    if options.quiet:
        overrides.append("quiet=true")
    if options.json:
        overrides.append("json=true")
    if "--traceback" in command_line():
        overrides.append("traceback=true")
    return overrides


def check_job(composed: Composed, verb: JobVerb, *, any_key: bool = False) -> Checked:
    """Check the whole config of a job, and that the verb reads each key of its command line.

    Args:
        composed: The config.
        verb: The verb of the job.
        any_key: Whether keys that the verb does not read are allowed, too.
    """
    from embodichain.config.resolved import check_config

    checked = check_config(composed, verb)
    if any_key:
        return checked
    unread = unread_keys(verb, composed.overrides)
    unread_paths = {problem.path for problem in unread}
    # That a key is not read is said in place of what else is wrong with it.
    others = [problem for problem in checked.check.problems if problem.path not in unread_paths]
    return replace(checked, check=replace(checked.check, problems=[*unread, *others]))


def resolve_job(composed: Composed, verb: JobVerb) -> Resolved:
    """Check the whole config of a job; for a training, the algorithm's arguments too.

    Raises:
        ConfigError: Lists every mistake with its file and line.
    """
    resolved = check_job(composed, verb).resolved()
    if verb == "train":
        from embodichain.learning.training.train import check_training

        with resolved.locating():
            check_training(resolved)
    return resolved


def execute(
    resolved: Resolved,
    work: Work,
    command: Sequence[str],
    folder: Path | None = None,
    *,
    verb: JobVerb = "run",
    is_continued: bool = False,
    in_sweep: bool = False,
    undo_claim: Callable[[], None] | None = None,
) -> float | None:
    """Compile the scene of a job, and run it in its folder, with a log file.

    Args:
        resolved: The config.
        work: The work of the job.
        command: The command line, as typed.
        folder: The run folder; None makes a new one, which is removed if the job is refused.
        verb: The verb of the job.
        is_continued: Whether the folder belongs to this job already; its config stays.
        in_sweep: Whether it is one of the jobs of a sweep.
        undo_claim: Called if the job is refused before it began, where `folder` is given.

    Raises:
        ConfigError: The scene cannot be compiled, or the folder cannot be made.
        Interrupted: A signal came; the files are complete up to that step.
        Exception: Any exception of `work`.
    """
    from embodichain.config.resolved import compile_scene_of

    # `last` and `latest` may be another run when the record of this job is read.
    resolved = pin_last(resolved)
    command = resolve_links(command)
    # Before a folder is made: a scene with mistakes leaves none.
    compiled_scene = compile_scene_of(resolved)
    if resolved.tree["sim"]["engine"] == "warp":
        from embodichain.config.environments.factory import with_warp_values

        with resolved.locating():
            resolved = with_warp_values(resolved, verb, compiled_scene=compiled_scene)
    if folder is None:
        folder, undo_claim = _claim_folder(resolved)
    job = Job(resolved, compiled_scene, folder, stop=StopFlag(), in_sweep=in_sweep)
    try:
        return _execute(job, work, command, is_continued=is_continued)
    except (ConfigError, RenderError):  # the input is wrong: exit code 2, nothing was started
        if not job.began.is_set() and undo_claim is not None:
            undo_claim()
        raise
    except BaseException:  # the folder stays, with a log that says what happened
        job.announce()
        raise


def _claim_folder(resolved: Resolved) -> tuple[Path, Callable[[], None]]:
    """Make a new run folder.

    Returns:
        The folder, and a function that removes it and what was made for it.

    Raises:
        ConfigError: It cannot be made.
    """
    from embodichain.config.run_folder import abandon, claim, latest_of, missing_folders

    output_dir = resolved.root.output_dir
    try:
        latest_before = latest_of(output_dir)
        new_folders = missing_folders(output_dir)
    except OSError as error:  # a name that is too long
        message = f"output_dir: cannot make a run folder in {output_dir}: {error}"
        raise ConfigError(message) from error
    folder = claim(output_dir, resolved.task_name)
    return folder, partial(abandon, folder, output_dir, latest_before, new_folders)


def pin_last(resolved: Resolved) -> Resolved:
    """Return the config with paths instead of the word ``last``, and print which training it is.

    Raises:
        ConfigError: There is no such training any more.
    """
    pinned_config = resolved.pinned()
    if resolved.tree["policy"] == "last":
        announce_last(Path(str(pinned_config.tree["policy"])))
    return pinned_config


def _execute(job: Job, work: Work, command: Sequence[str], *, is_continued: bool) -> float | None:
    """Run a job in its folder; see `execute`."""
    from embodichain.config.checks.viewer_access import without_token
    from embodichain.config.resolved import write_record
    from embodichain.config.run_folder import marked_as_running

    resolved = job.resolved
    folder = job.folder
    # Run folders are shared: having one must not open the viewer.
    command = without_token(replace_last(command))
    if not is_continued:
        write_record(folder, resolved, command)
    with marked_as_running(folder), log_to(folder / LOG_FILE) as log, job.stop as stop:
        log.info("command: %s", shlex.join(command))
        for note in resolved.notes:
            warn_once(log, str(note))
        with resolved.locating():
            check_extras(job.root)
            value = work(job)
        job.announce()  # what was finished before never began
        if stop.stopped is not None:
            message = f"interrupted ({stop.stopped}); {folder} is complete up to there"
            raise Interrupted.by(stop.stopped, message)
        log.info("done")
        return value


def check_extras(root: RootCfg) -> None:
    """Check that the video, the pictures of the log and the viewer can be made here.

    Raises:
        ConfigError: Packages are missing, with the names of the extras, or something of Linux.
        RenderError: Pictures cannot be drawn here, and nothing else is missing; names what to
            install.
    """
    # Everything that is missing is reported at once, so that one installation is enough.
    problems: list[Problem] = []
    render_error: RenderError | None = None
    for check in _checks_of_extras(root):
        try:
            check()
        except ConfigError as error:
            problems += error.problems
        except RenderError as error:
            render_error = error
    if render_error is not None:
        if not problems:
            raise render_error
        problems.append(Problem("", str(render_error)))
    if problems:
        raise ConfigError(problems)


def _shows_pictures(viewer: str) -> bool:
    """Whether a viewer draws pictures of cameras."""
    return viewer != NO_VIEWER and bool(VIEWERS[viewer].pictures)


def _checks_of_extras(root: RootCfg) -> Iterator[Callable[[], None]]:
    """Checks of packages and programs that are not installed with this package alone.

    Yields:
        Functions that raise a `ConfigError` or a `RenderError` that says what is missing.
    """
    viewer = root.viewer.name
    has_log = root.record.format != "none"
    if sys.platform in LIMITED:
        features = [f"viewer={viewer}"]
        if has_log:
            features.append("record=mcap")
        yield partial(platforms.need, *features)
    if viewer in VIEWERS.entry_names():  # a package outside: its module may not work
        yield partial(VIEWERS.__getitem__, viewer)
    images = root.record.images
    if not has_log and not _shows_pictures(viewer):
        images = None  # nothing takes them
    keys_that_draw = []
    if root.video:
        from embodichain.utils.system.video import film_suffix, need_encoder

        keys_that_draw.append("video")
        suffix = film_suffix(getattr(root.video, "format", None))
        yield partial(need_encoder, suffix)
    if images is not None:
        keys_that_draw.append("record.images")
        if images.format == "h264":
            from embodichain.recording.views.encoders import need_h264

            yield need_h264
    if keys_that_draw or "EMBODICHAIN_RENDERER" in os.environ:
        from embodichain.lab.sim.drawing.offscreen import need_colors

        yield partial(need_colors, *keys_that_draw)


def policy_name(root: RootCfg) -> str:
    """Return the name, import path or file of the policy that a config chooses."""
    policy = root.policy or "random"
    if isinstance(policy, str):
        return policy
    return policy.func


def policy_of(
    root: RootCfg, env: BaseEnv, policy: str | None = None, *, deterministic: bool = True
) -> Policy:
    """Return the policy from its name, its import path, or a training's folder or file.

    Args:
        root: The config.
        env: The environment that it will act in.
        policy: Replaces the policy of the config.
        deterministic: Whether a trained policy returns its mean action.

    Raises:
        ConfigError: There is no such policy, its parameters are wrong, it was trained in another
            task and ``allow_changed`` is not set, or its file can only be read by running code of
            it and ``trust`` is not set.
    """

    def load(path: Path) -> Policy:
        from embodichain.learning.policies.policy import load_policy

        return load_policy(
            path,
            env,
            deterministic=deterministic,
            allow_changed=root.allow_changed,
            trust=root.trust,
        )

    choice = policy or root.policy or "random"
    if isinstance(choice, str):
        return resolve_policy(choice, load_file=load)
    return resolve_policy({"func": choice.func, "params": choice.params}, load_file=load)


def film_progress(display: ProgressDisplay) -> Callable[[Filmed], None]:
    """Return a callback that shows how many pictures are made, and how long the rest takes."""
    start = 0.0
    was_shown = False

    def show(filmed: Filmed) -> None:
        nonlocal start, was_shown
        now = time.perf_counter()
        if filmed.pictures == 1:  # the first one takes longer: OpenGL starts
            start = now
            return
        is_first_notice = not was_shown and now - start >= _SAY_AFTER
        if display.due or is_first_notice:
            was_shown = True
            display.total = filmed.total
            seconds_each = (now - start) / (filmed.pictures - 1)
            seconds_left = seconds_each * (filmed.total - filmed.pictures)
            facts = {"step": f"{filmed.step}", "left": f"{seconds_left:.0f} s"}
            display.show(filmed.pictures, facts)

    return show


def describe_early_end(stop: StopFlag, filmed: Filmed, out: Path) -> str:
    """Return a message about a video that a signal ended early."""
    interruption = f"interrupted ({stop.stopped})"
    if not filmed.pictures:
        return f"{interruption}; {out} was not begun"
    extent = f"{filmed.pictures} pictures, up to control step {filmed.step}"
    return f"{interruption}; {out} is a complete film of the first {extent}"
