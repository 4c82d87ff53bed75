"""Shell completion: verbs are completed here, keys and values after a verb by Hydra.

The shell calls ``embodichain -sc query=bash`` with the line typed so far in ``COMP_LINE``; Hydra
must see it without the verb.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterable

from embodichain.cli import exits
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError

__all__ = ["complete"]

_WORDS = {
    "list": ("tasks", "robots", "terms"),
    "new": ("task",),
    "replay": ("last",),
    "view": ("last",),
    "export": ("policy",),
    "compare": ("last",),
}

_OF_RUNS = ("eval", "play")


def complete(arguments: list[str]) -> int:
    """Serve ``-sc install=SHELL``, ``uninstall=SHELL`` and ``query=SHELL``.

    Raises:
        ConfigError: Anything else.
    """
    request = arguments[0] if arguments else ""
    action, _, shell = request.partition("=")
    if action not in ("install", "uninstall", "query") or not shell:
        raise ConfigError("-sc takes install=SHELL or uninstall=SHELL; SHELL is bash, zsh or fish")
    if action != "query":
        return _hydra(request)
    words = os.environ.get("COMP_LINE", "").split()[1:]
    fresh = os.environ.get("COMP_LINE", "").endswith((" ", "\t"))
    if not words or (len(words) == 1 and not fresh):
        return _print(VERBS, words)
    verb = VERBS.get(words[0])
    if verb is None:
        return exits.OK
    if not verb.overrides:
        return _print(_WORDS.get(verb.name, ()), words[1:])
    typed = "" if fresh else words[-1]
    before = words[1:] if fresh else words[1:-1]
    if verb.name in _OF_RUNS and typed and "last".startswith(typed):
        return _print(("last",), [typed])
    # Hydra knows overrides only: a run or a task named by a bare word is not one.
    known = [word for word in before if "=" in word or word.startswith(("~", "-"))]
    os.environ["COMP_LINE"] = " ".join(["embodichain", *known, typed])
    return _hydra(request, verb.name)


def _print(candidates: Iterable[str], words: list[str]) -> int:
    start = words[-1] if words else ""
    names = [name for name in candidates if name.startswith(start)]
    sys.stdout.write(" ".join(names) + "\n")
    return exits.OK


def _hydra(request: str, verb: str = "run") -> int:
    from embodichain.cli.hydra_verb import call_hydra

    # Verbs that only read a config have the tree of `run`.
    module = importlib.import_module(f"embodichain.cli.{verb if verb == 'train' else 'run'}")
    call_hydra("embodichain", module.job, ["-sc", request])
    return exits.OK
