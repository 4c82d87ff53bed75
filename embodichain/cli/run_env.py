"""`embodichain run-env`: EmbodiChain's command, as `embodichain run --gym-config` with its flags.

Flags that mean nothing here are accepted, and said so; everything else is `run`'s.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

from embodichain.cli.arguments import VerbParser
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

__all__ = ["main"]

_KEYS = {
    "num_envs": "num_envs",
    "max_episodes": "episodes",
    "device": "device",
    "seed": "seed",
    "viser_host": "viewer.host",
    "viser_port": "viewer.port",
}
"""Flag -> key of the config of a run."""
_NO_EFFECT = {
    "renderer": "pictures are MuJoCo's",
    "arena_space": "every environment is its own world",
    "gpu_id": "physics runs on the CPU",
    "action_config": "not read: expert demonstrations are not generated here; policy=NAME acts",
    "preview": "viewer=web shows the run in a browser, viewer=native in a window",
    "filter_dataset_saving": "a run writes a log; `embodichain export` makes a data set of it",
    "viser_env_ids": "people choose the environment on the page",
    "viser_fps": "the page draws as fast as the browser asks",
    "viser_image_fps": "there are no camera images on the page",
    "viser_soft_body_fps": "there are no soft bodies",
}


def main(arguments: list[str]) -> int:
    """Translate the flags, then run.

    Raises:
        ConfigError: No gym config is named, a flag is unknown, or what `run` finds wrong.
    """
    options = _parser().parse(arguments)
    if not options.gym_config:
        raise ConfigError("no gym config is named: embodichain run-env --gym_config FILE")
    for flag, why in _NO_EFFECT.items():
        value = getattr(options, flag)
        if value is not None and value is not False:  # 0 is a value that was typed
            sys.stderr.write(f"note: --{flag} has no effect: {why}\n")
    from embodichain.cli.run import main as run

    flags = [f"--{name}" for name in ("quiet", "json", "traceback") if getattr(options, name)]
    return run([*_overrides(options), "--gym-config", options.gym_config, *flags])


def _overrides(options: argparse.Namespace) -> Iterator[str]:
    for flag, key in _KEYS.items():
        value = getattr(options, flag)
        if value is not None:
            yield f"{key}={value}"
    if options.viser:
        yield "viewer=web"
    if options.filter_visual_rand:
        yield from (f"~task.events.{name}" for name in _visual_events(options.gym_config))
    yield from options.overrides


def _visual_events(path: str) -> list[str]:
    """The events of a gym config that only change how things look."""
    from embodichain.compat.gym_config.conversion import convert
    from embodichain.compat.gym_config.file import read_gym_config
    from embodichain.compat.gym_config.functors import VISUAL

    events = convert(read_gym_config(path)).task.get("events", {})
    return [name for name, event in events.items() if event["func"] in VISUAL]


def _parser() -> VerbParser:
    """EmbodiChain's flags in both spellings, all unset: only what was typed counts."""
    from embodichain.compat.gym_utils import add_env_launcher_args_to_parser
    from embodichain.recording.viewers.visualization import add_viser_args_to_parser

    parser = VerbParser(VERBS["run-env"])
    parser.add_argument("overrides", nargs="*", metavar="key=value", help="any key of the config")
    add_env_launcher_args_to_parser(parser)
    add_viser_args_to_parser(parser)
    parser.add_argument("--max_episodes", type=int, help="episodes of each environment")
    parser.add_argument("--seed", type=int, help="seed of every random stream")
    for action in list(parser._actions):
        if action.option_strings and action.dest != "help":
            action.default = None
            _allow_dashes(parser, action)
    for name, text in (
        ("quiet", "no progress, no table"),
        ("json", "one JSON object on stdout, nothing else"),
        ("traceback", "show where an error happened"),
    ):
        parser.add_argument(f"--{name}", action="store_true", help=text)
    return parser


def _allow_dashes(parser: VerbParser, action: argparse.Action) -> None:
    """Release 0.3 spells the same flags with dashes."""
    for flag in list(action.option_strings):
        dashed = flag.replace("_", "-")
        if dashed != flag:
            action.option_strings = [*action.option_strings, dashed]
            parser._option_string_actions[dashed] = action
