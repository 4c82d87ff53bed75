"""`embodichain demo`: a robot that solves a task, on a page in the browser or in a film.

The policy is the trained one that ships for the task, else the task's expert.
"""

from __future__ import annotations

import sys
import webbrowser
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from embodichain.cli.jobs.job import Job, Work, execute, output_overrides, policy_of
from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.cli.jobs.work.run_job import run_job
from embodichain.cli.terminal.output import print_facts, print_json, print_table
from embodichain.cli.verb import OverrideOptions, command_line, overrides, verb
from embodichain.cli.words import split_overrides
from embodichain.utils.errors import ConfigError, Problem, RenderError

if TYPE_CHECKING:
    from embodichain.learning.episode_statistics import EpisodeStatistics
    from embodichain.recording.viewers.web import WebView

__all__ = ["command"]

_TASK = "pick_place"
_DEMOS = {
    _TASK: "an arm with a gripper puts a cube on a stand; its expert plans the motions",
    "push_cube": "an arm pushes a cube to a mark; a trained policy that ships",
    "cart_pole_swing_up": "a pole is swung up and balanced; a trained policy that ships",
}
"""Tasks to begin with, and what is to be seen; none needs the network or an extra."""
_SEED = "1"
_DEFAULTS = {"num_envs": "1", "seed": _SEED}
_PAGE_DEFAULTS = {"viewer": "web", "record": "none", "scene_png": "false", "episodes": "100"}
_FILM_DEFAULTS = {"video": "true", "scene_png": "false", "episodes": "1"}


@dataclass(frozen=True, kw_only=True)
class DemoOptions(OverrideOptions):
    """What was typed after `demo`.

    Attributes:
        web: Show a page.
        film: Write a film.
        lists: List demos.
    """

    web: bool
    film: bool
    lists: bool


@verb(
    "demo",
    ("demo", "an arm puts a cube on a stand, in the browser"),
    ("demo --list", "three to begin with"),
    ("demo push_cube", "a trained policy that ships: embodichain list policies"),
    ("demo --film", "a film; also where there is no display"),
    ("demo --web viewer.port=8090", "the page, for a browser of another machine (ssh -L)"),
    options=DemoOptions,
    keys=True,
    config_dir=True,
    quiet=True,
)
@overrides("[TASK] [KEY=VALUE]...")
@click.option("--web", is_flag=True, help="A page. Default, if there is a display.")
@click.option("--film", is_flag=True, help="A film in a new run folder. Default without a display.")
@click.option("--list", "lists", is_flag=True, help="List three demos.")
def command(options: DemoOptions) -> None:
    """Show a task that is solved."""
    if options.lists:
        _print_demos(options)
        return
    from embodichain.config.resolved import resolve
    from embodichain.utils.system.display import has_display

    if options.web and options.film:
        raise ConfigError("--web and --film exclude each other")
    display = has_display()
    on_page = options.web or (display and not options.film)
    lines = split_overrides(options.words)
    refuse_unread("demo", lines)
    if on_page:
        refuse_unread("demo --web", lines)
    typed_keys = {line.partition("=")[0].lstrip("+~") for line in lines}
    if typed_keys.isdisjoint(("task", "gym_config")):
        lines.append(f"task={_TASK}")
    if "policy" not in typed_keys:
        lines.append(f"policy={_choose_policy(lines)}")
    defaults = dict(_DEFAULTS)
    work: Work
    if on_page:
        defaults |= _PAGE_DEFAULTS
        work = _Page(opens_browser=display)
    else:
        defaults |= _FILM_DEFAULTS
        work = run_job
    lines += [f"{key}={value}" for key, value in defaults.items() if key not in typed_keys]
    resolved = resolve([*lines, *output_overrides(options)], "run")
    try:
        execute(resolved, work, command_line())
    except RenderError as error:
        raise RenderError(f"{error}\n--web shows it in a browser, without OpenGL here") from error


def _print_demos(options: DemoOptions) -> None:
    """Print the demos to begin with.

    Raises:
        ConfigError: Something else was typed too.
    """
    if options.words or options.web or options.film:
        raise ConfigError("--list lists the demos, and shows none: type it alone")
    demos = [
        {"task": task, "shows": shows, "command": f"embodichain demo {task}"}
        for task, shows in _DEMOS.items()
    ]
    if options.json:
        print_json({"demos": demos})
        return
    print_table("demos", demos)
    sys.stdout.write(
        "None needs the network. Other tasks with an expert or a policy that ships "
        "(embodichain list policies) are shown too.\n"
    )


def _choose_policy(lines: list[str]) -> str:
    """Return the policy that solves the task: a trained one that ships, else its expert.

    Raises:
        ConfigError: If the task has none, or there is no such task.
    """
    from embodichain.config.composition.composed import compose
    from embodichain.data.pretrained import pretrained_tasks

    composed = compose(lines, "run")
    name = composed.choices.get("task")
    tasks = pretrained_tasks()
    if name in tasks:
        return "pretrained"
    if composed.problems:  # they are reported where the task is resolved
        return "expert"
    task = composed.tree.get("task")
    if isinstance(task, dict) and task.get("expert"):
        return "expert"
    message = (
        f"{name} has no `expert`, and no trained policy ships for it, only for {', '.join(tasks)}; "
        f"`embodichain train task={name}`, then `embodichain play last`"
    )
    raise ConfigError([Problem("task", message)])


class _Page:
    """Plays episodes on a page, until it is closed, Ctrl-C is pressed, or all are played.

    Args:
        opens_browser: Whether to open a browser here.
    """

    def __init__(self, *, opens_browser: bool) -> None:
        self._opens_browser = opens_browser

    def __call__(self, job: Job) -> float | None:
        """Play; the first step waits for a browser."""
        from embodichain.config.environments.factory import make_env
        from embodichain.learning.episode_statistics import EpisodeStatistics, play

        counted = EpisodeStatistics(int(job.root.num_envs or 1), int(job.root.episodes or 1))
        env = make_env(job.resolved, compiled_scene=job.compiled_scene, run_dir=job.folder)
        try:
            policy = policy_of(job.root, env)
            shown = job.attach_viewer(env, policy)
            watching = job.watching(shown)
            obs, _ = env.reset()
            job.begin()
            if self._opens_browser and shown is not None and shown.page is not None:
                self._open_browser(shown.page)
            if watching is not None:
                watching.wait()
            steps = iter(()) if job.stop.is_stopped() else play(env, policy, obs, counted)
            for _ in steps:
                is_over = watching is not None and not watching.hold("that ends the demo")
                if is_over or job.stop.is_stopped():
                    break
            _print_result(job, counted)
            if watching is not None:
                watching.stay()
        finally:
            env.close()
        return counted.mean("success")

    def _open_browser(self, page: WebView) -> None:
        """Open the page in a browser of this machine."""
        # Other users can read a browser's command line: its URL opens one page, once.
        if not webbrowser.open(page.url_once):
            sys.stderr.write("no browser could be opened here\n")


def _print_result(job: Job, counted: EpisodeStatistics) -> None:
    """Print how many episodes were played, and how many of them were solved."""
    task = job.resolved.task_name
    success = counted.mean("success")
    if job.root.json:
        print_json({"task": task, "episodes": counted.episodes, "success": success})
    elif not job.quiet:
        share = None if success is None else f"{success:.0%}"
        print_facts(task, [("episodes", counted.episodes), ("success", share)])
    sys.stdout.flush()
