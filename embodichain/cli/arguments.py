"""Argument parsing that all verbs share: errors with the closest match, output that is not mixed.

Hydra's own flags live in `hydra_verb`, what a verb takes in its module.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterable
from typing import Any, NoReturn

from embodichain.cli.verbs import EXIT_CODES, Verb
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = ["VerbParser", "add_common", "print_json", "split_overrides", "to_json"]


class VerbParser(argparse.ArgumentParser):
    """A parser whose errors are `ConfigError`s and whose help ends with the verb's examples."""

    def __init__(self, verb: Verb) -> None:
        super().__init__(
            prog=f"embodichain {verb.name}",
            usage=f"embodichain {verb.name} {verb.usage}",
            description=verb.summary,
            epilog=f"{verb.epilog()}\n\n{EXIT_CODES}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def parse(self, arguments: list[str]) -> argparse.Namespace:
        """Parse; flags and positionals may stand in any order.

        Raises:
            ConfigError: An unknown flag (with the closest), a missing or a superfluous argument.
        """
        _refuse_unknown_flags(self, arguments)
        return self.parse_intermixed_args(arguments)

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage and leaving."""
        raise ConfigError(f"{message}\n{self.format_usage().strip()}")


def _refuse_unknown_flags(parser: argparse.ArgumentParser, arguments: Iterable[str]) -> None:
    """Raise ConfigError for a flag that `parser` does not know, naming the closest it does.

    argparse itself would list every flag, or take an unknown one for a value.
    """
    known = list(parser._option_string_actions)
    for argument in arguments:
        flag = argument.split("=", 1)[0]
        if re.match(r"--?[A-Za-z]", flag) and flag not in known and not _clustered(flag, known):
            hint = did_you_mean(flag, known)
            raise ConfigError(f"unknown option {flag}.{hint} `{parser.prog} --help` lists them.")


def _clustered(flag: str, known: list[str]) -> bool:
    """Whether `flag` is a short flag with its value attached (``-cjob``)."""
    return not flag.startswith("--") and any(
        len(k) == 2 and flag.startswith(k) for k in known if not k.startswith("--")
    )


def add_common(parser: argparse.ArgumentParser, *, config_dir: bool = False) -> None:
    """Add `--json`, `--traceback` and, where YAML is read, `--config-dir`."""
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--traceback", action="store_true", help="show where an error happened")
    if config_dir:
        parser.add_argument(
            "--config-dir", "-cd", metavar="DIR", help="search this folder for YAML first"
        )


def print_json(value: dict[str, Any]) -> None:
    """Write one JSON object to stdout, on one line: a sweep's jobs give JSON lines."""
    sys.stdout.write(to_json(value) + "\n")
    sys.stdout.flush()


def to_json(value: dict[str, Any], indent: int | None = None) -> str:
    """Return JSON; numbers that it lacks (nan, inf) become null, arrays lists, the rest text."""
    return json.dumps(_finite(value), indent=indent, default=_plain, allow_nan=False)


def _plain(value: Any) -> Any:
    return _finite(value.tolist()) if hasattr(value, "tolist") else str(value)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value


def split_overrides(words: list[str]) -> list[str]:
    """Turn what was typed into overrides: a bare word names the task.

    Raises:
        ConfigError: More than one bare word.
    """
    bare = [word for word in words if "=" not in word and not word.startswith("~")]
    if len(bare) > 1:
        raise ConfigError(f"one task at a time: {', '.join(bare)}. Values are given as key=value")
    return [*(f"task={word}" for word in bare), *(word for word in words if word not in bare)]
