"""The options of verbs that serve a log: who may connect."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import click

__all__ = ["access_given", "access_options"]

_Command = TypeVar("_Command", bound=Callable[..., Any])


def access_options(of: str) -> Callable[[_Command], _Command]:
    """Add `--token`, `--allow-host` and `--allow-origin` to a verb.

    Args:
        of: The option that serves, for the help.
    """
    options = (
        click.option(
            "--token",
            metavar="TEXT",
            help=f"What {of} asks for: auto draws it (the default), none asks for none.",
        ),
        click.option(
            *("--allow-host", "allow_hosts"),
            metavar="NAME",
            multiple=True,
            help="A name of the server beside its address. May be repeated.",
        ),
        click.option(
            *("--allow-origin", "allow_origins"),
            metavar="SITE",
            multiple=True,
            help="A site whose pages may connect. May be repeated.",
        ),
    )

    def add(command: _Command) -> _Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def access_given(options: Mapping[str, Any]) -> Any:
    """Return the `Access` of these options; those that were not given have its defaults."""
    from embodichain.utils.system.access import AUTO, Access

    token = AUTO if options["token"] is None else options["token"]
    origins = options["allow_origins"] or None
    return Access(token, options["allow_hosts"], origins)
