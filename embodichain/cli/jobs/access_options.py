"""The options of verbs that serve a log: who may connect."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import click

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.utils.system.access import Access

__all__ = ["AccessOptions", "access_options", "naming_flags"]

_PORT = "viewer.port"
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
            "--allow-host",
            "allow_hosts",
            metavar="NAME",
            multiple=True,
            help="A name of the server beside its address. May be repeated.",
        ),
        click.option(
            "--allow-origin",
            "allow_origins",
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


@contextmanager
def naming_flags() -> Iterator[None]:
    """Name the flag `--port` in a mistake of `viewer.port`: these verbs take no keys."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError([_with_flag(problem) for problem in error.problems]) from error


def _with_flag(problem: Problem) -> Problem:
    if problem.path != _PORT:
        return problem
    return replace(problem, path="--port", hint=problem.hint.replace(f"{_PORT}=N", "--port N"))


@dataclass(frozen=True, kw_only=True)
class AccessOptions:
    """Who may connect to a verb that serves a log; values that were not typed are empty.

    Attributes:
        token: What the server asks for: ``auto`` draws it, ``none`` asks for none.
        allow_hosts: Names of the server beside its address.
        allow_origins: Sites whose pages may connect.
    """

    token: str | None
    allow_hosts: tuple[str, ...]
    allow_origins: tuple[str, ...]

    @property
    def access(self) -> Access:
        """Who may connect, with the defaults of what was not typed."""
        from embodichain.utils.system.access import AUTO, Access

        token = AUTO if self.token is None else self.token
        return Access(token, self.allow_hosts, self.allow_origins or None)
