"""`embodichain list`: which tasks, robots and terms there are. Imports no simulator, no torch."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json
from embodichain.cli.tables import print_table, width
from embodichain.cli.verbs import VERBS
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from hydra.plugins.config_source import ConfigSource

__all__ = ["main"]

Rows = list[dict[str, Any]]


def main(arguments: list[str]) -> int:
    """List what is asked for, as a table or as JSON."""
    parser = VerbParser(VERBS["list"])
    parser.add_argument("what", nargs="?", metavar="tasks|robots|terms")
    parser.add_argument("--markdown", action="store_true", help="terms as the page docs/terms.md")
    add_common(parser, config_dir=True)
    options = parser.parse(arguments)
    lister = _LISTERS.get(options.what)
    if lister is None:
        if options.what is None:
            raise ConfigError(f"list what? One of: {', '.join(_LISTERS)}")
        hint = did_you_mean(options.what, _LISTERS)
        raise ConfigError(f"nothing called '{options.what}' to list.{hint} {', '.join(_LISTERS)}")
    if options.markdown:
        return _page(options)
    rows = lister(options)
    if options.json:
        print_json({options.what: rows})
    else:
        print_table(options.what, rows, detail="cannot load")
        if options.what == "robots" and (absent := _absent_robots(rows)):
            sys.stdout.write("not here:\n")
            for line in absent:
                sys.stdout.write(
                    textwrap.fill(
                        line,
                        width(),
                        initial_indent="  ",
                        subsequent_indent="    ",
                        break_long_words=False,
                        break_on_hyphens=False,
                    )
                    + "\n"
                )
            sys.stdout.write("\n")
    return exits.OK


def _page(options: argparse.Namespace) -> int:
    """The catalogue of terms, for people."""
    if options.what != "terms" or options.json:
        raise ConfigError("--markdown goes with `list terms`, without --json")
    from embodichain.cli.catalogue import catalogue

    sys.stdout.write(catalogue())
    return exits.OK


def _tasks(options: argparse.Namespace) -> Rows:
    """Every option of the group `task`, wherever it is searched; a broken file is listed too."""
    from embodichain.config.hydra_state import config_loader

    with config_loader(options.config_dir) as loader:
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


def _robots(options: argparse.Namespace) -> Rows:
    from embodichain.data import fault_of, list_robots

    return [
        {
            "name": asset.name,
            "format": asset.format,
            "from": asset.source,
            "cannot load": fault_of(asset.path),
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


def _terms(options: argparse.Namespace) -> Rows:
    from embodichain.cli.term_entries import SECTION_OF, all_entries

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


_LISTERS: dict[str, Callable[[argparse.Namespace], Rows]] = {
    "tasks": _tasks,
    "robots": _robots,
    "terms": _terms,
}
