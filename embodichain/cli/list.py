"""`embodichain list`: which tasks, robots and terms there are. Imports no simulator, no torch."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.app import common, verb
from embodichain.cli.output import print_json, print_table, wrapped
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from hydra.plugins.config_source import ConfigSource

__all__ = ["command"]

Rows = list[dict[str, Any]]
_FAULT = "cannot load"
_WHAT = ("tasks", "robots", "terms")


def _complete(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    return [word for word in _WHAT if word.startswith(incomplete)]


@verb(
    "list",
    ("list tasks", "every task that task=NAME finds"),
    ("list robots", "robot files that a task can name"),
    ("list terms", "functions for events, observations, rewards, ..."),
    ("list terms --markdown", "the same as a page, with parameters and examples"),
)
@click.argument("what", required=False, metavar="tasks|robots|terms", shell_complete=_complete)
@click.option("--markdown", is_flag=True, help="Terms as the page docs/terms.md.")
@common(config_dir=True)
def command(
    what: str | None, markdown: bool, config_dir: str | None, json: bool, traceback: bool
) -> None:
    """List what is asked for, as a table or as JSON."""
    lister = _LISTERS.get(what or "")
    if lister is None or what is None:
        if what is None:
            raise ConfigError(f"list what? One of: {', '.join(_LISTERS)}")
        hint = did_you_mean(what, _LISTERS)
        raise ConfigError(f"nothing called '{what}' to list.{hint} {', '.join(_LISTERS)}")
    if markdown:
        if what != "terms" or json:
            raise ConfigError("--markdown goes with `list terms`, without --json")
        from embodichain.cli.terms import catalogue

        sys.stdout.write(catalogue())
        return
    rows = lister(config_dir)
    if json:
        print_json({what: rows})
        return
    faults = [f"{row['name']}: {text}" for row in rows if (text := row.get(_FAULT))]
    print_table(what, [{k: v for k, v in row.items() if k != _FAULT} for row in rows])
    _print_list(_FAULT, faults)
    if what == "robots":
        _print_list("not here", _absent_robots(rows))


def _print_list(title: str, lines: list[str]) -> None:
    if lines:
        folded = [f"{wrapped(line, '  ', '    ')}\n" for line in lines]
        sys.stdout.write("".join([f"{title}:\n", *folded, "\n"]))


def _tasks(config_dir: str | None) -> Rows:
    """Every option of the group `task`, wherever it is searched; a broken file is listed too."""
    from embodichain.config.hydra_loader import config_loader

    with config_loader(config_dir) as loader:
        sources = loader.get_sources()
        names = loader.get_group_options("task")
        places = {n: next(s for s in sources if s.is_config(f"task/{n}")) for n in names}
        return [
            {
                "name": name,
                "what": _description(source, f"task/{name}"),
                "from": "embodichain" if source.provider == "main" else source.provider,
            }
            for name, source in places.items()
        ]


def _description(source: ConfigSource, path: str) -> str:
    import yaml
    from omegaconf import DictConfig

    try:
        config = source.load_config(path).config
    except yaml.YAMLError:
        return f"(malformed YAML: embodichain validate task={path.removeprefix('task/')})"
    return str(config.get("description", "")) if isinstance(config, DictConfig) else ""


def _robots(config_dir: str | None) -> Rows:
    from embodichain.data import fault_of, list_robots

    return [
        {
            "name": asset.name,
            "format": asset.format,
            "from": asset.source,
            _FAULT: fault_of(asset.path),
        }
        for asset in list_robots()
    ]


def _absent_robots(rows: Rows) -> list[str]:
    """Places of robots of which there is nothing here, and how to fill them."""
    from embodichain.data import data_root
    from embodichain.data.menagerie import HOW

    ways = {
        "example-robot-data": "example-robot-data: `pip install 'embodichain[robots]'`",
        "menagerie": HOW,
        "EMBODICHAIN_DATA_ROOT": f"your own: files below {data_root()} ($EMBODICHAIN_DATA_ROOT)",
    }
    found = {row["from"].partition(",")[0] for row in rows}
    return [way for place, way in ways.items() if place not in found]


def _terms(config_dir: str | None) -> Rows:
    from embodichain.cli.terms import SECTION_OF, all_entries

    entries = all_entries()
    return [
        {
            "kind": kind,
            "name": entry.name,
            "params": entry.signature.removeprefix(entry.name)[1:-1],
            "what": entry.doc.summary,
        }
        for kind in SECTION_OF
        for entry in entries
        if kind in entry.kinds
    ]


_LISTERS: dict[str, Callable[[str | None], Rows]] = {
    "tasks": _tasks,
    "robots": _robots,
    "terms": _terms,
}
