"""What `run` and `train` share: flags and positionals become overrides, mistakes come before Hydra.

Hydra knows no verbs. Its own `main` does multirun, launchers, `--cfg`, `--info`: it is called
with the verb's rest of the command line; exceptions pass through it to our one report.
"""

from __future__ import annotations

import argparse
import logging
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Literal

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, split_overrides
from embodichain.cli.jobs import COMMAND_VARIABLE, given
from embodichain.cli.resuming import asks_to_resume, resolve_resumed
from embodichain.cli.verbs import VERBS, Verb
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = ["call_hydra", "call_verb"]

_MOST_CHECKED_JOBS = 64
_INFO = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")


def call_verb(name: Literal["run", "train"], job: Callable[..., None], arguments: list[str]) -> int:
    """Parse, check every job's config, then call `job` once, or let Hydra do what it is asked for.

    A single run needs Hydra no more once its config is composed; calling its `main` would compose
    that twice again before the first step.

    Args:
        name: The verb.
        job: A function decorated with `hydra.main`.
        arguments: What stands after the verb.

    Raises:
        ConfigError: Wrong flags, or mistakes in the config of any job: nothing has started.
    """
    options = _parser(VERBS[name]).parse(arguments)
    overrides = _overrides(options)
    os.environ[COMMAND_VARIABLE] = shlex.join(["embodichain", name, *arguments])
    if name == "train" and asks_to_resume(overrides):
        if options.multirun or options.cfg or options.info or any(map(_is_hydras, overrides)):
            raise ConfigError("resume goes on with one training: no --multirun, no key of Hydra's")
        with _searching(options.config_dir), given(resolve_resumed(overrides)):
            job({})
        return exits.OK
    with _searching(options.config_dir):
        if options.cfg is not None or options.info is not None:
            if options.cfg is not None and any(map(_names_gym_config, overrides)):
                raise ConfigError("--cfg prints YAML only: embodichain convert prints a gym config")
            _check_composes(name, overrides)
        elif options.multirun:
            from embodichain.cli.labels import SWEPT_VARIABLE
            from embodichain.cli.sweeping import points, swept, towards_scores

            os.environ[SWEPT_VARIABLE] = ",".join(swept(overrides))
            for point in points(overrides, _MOST_CHECKED_JOBS):
                _resolve(name, point)
            overrides = towards_scores(overrides)
        else:
            resolved = _resolve(name, overrides)
            if not any(map(_is_hydras, overrides)):
                with given(resolved):
                    job({})
                return exits.OK
        call_hydra(f"embodichain {name}", job, [*_flags(options), *_relaxed(overrides)])
    return exits.OK


def call_hydra(program: str, job: Callable[..., None], arguments: list[str]) -> None:
    """Call a `hydra.main` function with these arguments; its exceptions come out as they are."""
    with _process(program, arguments):
        job()


def _parser(verb: Verb) -> VerbParser:
    parser = VerbParser(verb)
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="any key of the config")
    own = parser.add_argument_group("output")
    own.add_argument("--quiet", "-q", action="store_true", help="no progress, no table")
    own.add_argument("--json", action="store_true", help="one JSON object on stdout, nothing else")
    own.add_argument("--traceback", action="store_true", help="show where an error happened")
    parser.add_argument(
        "--gym-config", metavar="FILE", help="EmbodiChain's own config of a task, instead of task="
    )
    hydra = parser.add_argument_group("config (Hydra's)")
    hydra.add_argument("--multirun", "-m", action="store_true", help="one job for each value")
    hydra.add_argument("--cfg", "-c", choices=("job", "hydra", "all"), help="print the config")
    hydra.add_argument("--resolve", action="store_true", help="with --cfg: resolve interpolations")
    hydra.add_argument("--package", "-p", metavar="KEY", help="with --cfg: only this part")
    hydra.add_argument(
        "--info", "-i", nargs="?", const="all", choices=_INFO, help="print how it was composed"
    )
    hydra.add_argument(
        "--config-dir", "-cd", metavar="DIR", help="search this folder for YAML first"
    )
    return parser


def _overrides(options: argparse.Namespace) -> list[str]:
    """What was typed as overrides, our flags as keys.

    A sweep's workers see overrides only, so everything they must know is one.
    """
    flags = [f"{name}=true" for name in ("quiet", "json", "traceback") if getattr(options, name)]
    if options.gym_config is not None:
        from embodichain.config.gym_config import override_of

        flags.append(override_of(options.gym_config))
    return [*split_overrides(options.overrides), *flags]


def _flags(options: argparse.Namespace) -> list[str]:
    """Hydra's flags, before the overrides, which is the only order that its parser takes."""
    flags = ["--multirun"] if options.multirun else []
    flags += ["--resolve"] if options.resolve else []
    for name in ("cfg", "package", "info"):
        value = getattr(options, name)
        if value is not None:
            flags += [f"--{name}", value]
    return flags


def _searching(config_dir: str | None) -> AbstractContextManager[None]:
    from embodichain.config.search_path import user_configs

    return user_configs(config_dir)


def _relaxed(overrides: list[str]) -> list[str]:
    """Overrides as Hydra's own `main` takes them, which refuses keys that no file spells out."""
    from embodichain.config.composed import WITHOUT_TASK
    from embodichain.config.hydra_state import config_loader
    from embodichain.config.overrides import relax

    with config_loader() as loader:
        relaxed = relax(overrides, loader)
    return [*relaxed, WITHOUT_TASK] if any(map(_names_gym_config, overrides)) else relaxed


def _resolve(name: Literal["run", "train"], overrides: list[str]) -> Resolved:
    """Compose a job's config and check it as a whole."""
    from embodichain.cli.checking import resolved_job
    from embodichain.config.composed import compose

    return resolved_job(compose(overrides, name), name)


def _check_composes(name: str, overrides: list[str]) -> None:
    """Raise what is wrong with overrides and files, not with values: for printing the config."""
    from embodichain.config.composed import compose

    composed = compose(overrides, name)
    if composed.problems:
        raise ConfigError(composed.problems)


def _is_hydras(override: str) -> bool:
    """Whether an override is about Hydra itself: callbacks, its folders, environment variables."""
    return override.lstrip("+~").startswith(("hydra.", "hydra/"))


def _names_gym_config(override: str) -> bool:
    return override.lstrip("+").startswith("gym_config=")


@contextmanager
def _process(program: str, arguments: list[str]) -> Iterator[None]:
    """The process as Hydra wants it: its arguments in `sys.argv`, exceptions not printed by it.

    What Hydra changes in `logging` is undone afterwards.
    """
    argv, full = sys.argv, os.environ.get("HYDRA_FULL_ERROR")
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    sys.argv = [program, *arguments]
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        yield
    finally:
        sys.argv = argv
        root.handlers[:] = handlers
        root.setLevel(level)
        if full is None:
            del os.environ["HYDRA_FULL_ERROR"]
        else:
            os.environ["HYDRA_FULL_ERROR"] = full
