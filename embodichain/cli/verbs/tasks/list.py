"""`embodichain list`: lists tasks, objects, robots, policies, terms and what else is registered.

Imports neither MuJoCo nor torch.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.terminal.output import print_json, print_table, wrapped
from embodichain.cli.verb import verb
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from hydra.core.config_loader import ConfigLoader
    from hydra.plugins.config_source import ConfigSource

__all__ = ["command"]

Rows = list[dict[str, Any]]
_FAULT = "cannot load"
_KINDS = (
    "tasks",
    "embodiments",
    "objects",
    "scenes",
    "variations",
    "studies",
    "suites",
    "robots",
    "policies",
    "terms",
    "formats",
    "viewers",
    "learners",
    "steps",
    "engines",
    "renderers",
)


@dataclass(frozen=True)
class ListOptions:
    """What was typed after `list`.

    Attributes:
        what: The kind: an entry of `_KINDS`.
        markdown: Print terms as the page docs/terms.md.
        json: Print the result as one JSON object.
    """

    what: str
    markdown: bool
    json: bool


@verb(
    "list",
    ("list tasks", "every task that task=NAME finds"),
    ("list embodiments", "robots that embodiment=NAME puts into a task"),
    ("list objects", "things that a task's defaults can compose"),
    ("list variations", "what variation=[NAME,...] finds"),
    ("list studies", "what `embodichain study NAME` finds"),
    ("list robots", "robot files that a task can name"),
    ("list policies", "trained policies that ship, and how often they succeed"),
    ("list terms", "functions for events, observations, rewards, ..."),
    ("list terms --markdown", "the same as a page, with parameters and examples"),
    ("list formats", "what logs can be exported as"),
    ("list learners", "algorithms of algo=NAME"),
    ("list engines", "what sim.engine=NAME finds"),
    ("list renderers", "what draws pictures"),
    options=ListOptions,
    config_dir=True,
)
@click.argument("what", type=click.Choice(_KINDS))
@click.option("--markdown", is_flag=True, help="Terms as the page docs/terms.md.")
def command(options: ListOptions) -> None:
    """List things of one kind, as a table or as JSON."""
    if options.markdown:
        if options.what != "terms" or options.json:
            raise ConfigError("--markdown goes with `list terms`, without --json")
        from embodichain.cli.results.terms import catalogue

        sys.stdout.write(catalogue())
        return
    makers = {
        "tasks": lambda: _described("task"),
        "embodiments": _embodiments,
        "objects": lambda: _commented("object"),
        "scenes": lambda: _commented("scene"),
        "variations": lambda: _described("variation"),
        "studies": lambda: _described("study"),
        "suites": lambda: _commented("suite"),
        "robots": _robots,
        "policies": _policies,
        "terms": _terms,
        "formats": _formats,
        "viewers": _viewers,
        "learners": _learners,
        "steps": _steps,
        "engines": _engines,
        "renderers": _renderers,
    }
    rows = makers[options.what]()
    if options.json:
        print_json({options.what: rows})
        return
    faults = [f"{row['name']}: {row[_FAULT]}" for row in rows if row.get(_FAULT)]
    for row in rows:
        row.pop(_FAULT, None)  # a sentence, too long for a column
        if "what" in row:
            row["what"] = row["what"] or "-"
    print_table(options.what, rows)
    _print_list(_FAULT, faults)
    if options.what == "robots":
        _print_list("not here", _absent_robots(rows))


def _print_list(title: str, lines: list[str]) -> None:
    if not lines:
        return
    folded = [wrapped(line, first="  ", rest="    ") for line in lines]
    sys.stdout.write("\n".join([f"{title}:", *folded, "\n"]))


def _described(group: str) -> Rows:
    """Every option of a group whose files have a description; a broken file is listed too."""
    from embodichain.config.composition.hydra_loader import config_loader, origin_of

    with config_loader() as loader:
        return [
            {
                "name": name,
                "what": _description(source, f"{group}/{name}"),
                "from": origin_of(source),
            }
            for name, source in _options(loader, group)
        ]


def _commented(group: str) -> Rows:
    """Every option of a group whose files begin with a comment that says what it is."""
    from embodichain.config.composition.hydra_loader import (
        config_loader,
        folder_of_source,
        origin_of,
    )

    rows = []
    with config_loader() as loader:
        for name, source in _options(loader, group):
            folder = folder_of_source(source.scheme(), source.path)
            what = "" if folder is None else _comment(folder / group / f"{name}.yaml")
            rows.append({"name": name, "what": what, "from": origin_of(source)})
    return rows


def _options(loader: ConfigLoader, group: str) -> Iterator[tuple[str, ConfigSource]]:
    """Yield the options of a group and where each is found first."""
    for name in loader.get_group_options(group):
        yield name, next(s for s in loader.get_sources() if s.is_config(f"{group}/{name}"))


def _comment(file: Path) -> str:
    """The first sentence of the comment that a file begins with."""
    words: list[str] = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        words += line.removeprefix("#").split()
    return " ".join(words).partition(". ")[0].rstrip(".")


def _description(source: ConfigSource, path: str) -> str:
    import yaml
    from omegaconf import DictConfig, OmegaConf

    from embodichain.utils.env_text import is_from_env, shown

    try:
        config = source.load_config(path).config
    except yaml.YAMLError:
        return f"(malformed YAML: embodichain validate {path.replace('/', '=', 1)})"
    if not isinstance(config, DictConfig):
        return ""
    if path.startswith("variation/"):  # placed by its header
        config = next(iter(config.task.variations.values())) if "task" in config else config
    raw: Any = OmegaConf.to_container(config, resolve=False)
    description = raw.get("description", "")
    if is_from_env(description):  # may be a secret
        return str(shown(description))
    return str(config.get("description", ""))


def _embodiments() -> Rows:
    """Every option of the group `embodiment` in the search path, and the names that it gives."""
    from embodichain.config.composition.embodiments import list_embodiments
    from embodichain.data import get_data_path

    rows = []
    for embodiment in list_embodiments():
        fault = embodiment.fault
        for fpath in embodiment.files:
            try:
                get_data_path(fpath)
            except (ConfigError, OSError) as error:
                fault = fault or str(error).partition(". Searched")[0].splitlines()[0]
        rows.append(
            {
                "name": embodiment.name,
                "robots": ", ".join(embodiment.robots),
                "names": ", ".join(embodiment.names),
                "control parts": ", ".join(embodiment.parts),
                "from": embodiment.source,
                _FAULT: fault,
            }
        )
    return rows


def _robots() -> Rows:
    from embodichain.data import fault_of, list_robots

    return [
        {
            "name": robot.name,
            "format": robot.format,
            "from": robot.source,
            _FAULT: fault_of(robot.path),
        }
        for robot in list_robots()
    ]


def _policies() -> Rows:
    """The policies that ship; ``policy=pretrained`` is that of the task."""
    from embodichain.data.pretrained import pretrained, pretrained_tasks

    rows = []
    for about in map(pretrained, pretrained_tasks()):
        low, high = about.interval
        success = f"{about.success:.1%}  [{low:.1%}, {high:.1%}] of {about.episodes}"
        rows.append({"task": about.task, "success": success, "made by": about.command})
    return rows


def _absent_robots(rows: Rows) -> list[str]:
    """Sources of robots that are not installed, and how to get them."""
    from embodichain.data import data_root
    from embodichain.data.lookup import HOW

    ways = {
        "example-robot-data": "example-robot-data: `pip install 'embodichain[robots]'`",
        "menagerie": HOW,
        "EMBODICHAIN_DATA_ROOT": f"your own: files below {data_root()} ($EMBODICHAIN_DATA_ROOT)",
    }
    present_sources = {row["from"].partition(",")[0] for row in rows}
    return [way for source, way in ways.items() if source not in present_sources]


def _terms() -> Rows:
    from embodichain.cli.results.terms import SECTION_OF, all_entries

    entries = all_entries()
    rows = []
    for kind in SECTION_OF:
        for entry in entries:
            if kind not in entry.kinds:
                continue
            rows.append(
                {
                    "kind": kind,
                    "name": entry.name,
                    "params": entry.signature.removeprefix(entry.name)[1:-1],  # without brackets
                    "what": entry.doc.summary,
                }
            )
    return rows


def _formats() -> Rows:
    """Formats of logs, none of which is imported."""
    from embodichain.recording.export.format_register import EPISODE_FORMATS, FORMATS

    rows = [
        {"name": name, "of": "the log", "what": summary}
        for name, summary in FORMATS.summaries().items()
    ]
    rows += [
        {"name": name, "of": "observations", "what": summary}
        for name, summary in EPISODE_FORMATS.summaries().items()
    ]
    return rows


def _viewers() -> Rows:
    """Viewers, none of which is imported."""
    from embodichain.config.keys.viewers import VIEWERS

    return [{"name": name, "what": summary} for name, summary in VIEWERS.summaries().items()]


def _engines() -> Rows:
    """Engines, none of which is imported."""
    from embodichain.lab.sim.engine.engine_register import ENGINES

    return [{"name": name, "what": summary} for name, summary in ENGINES.summaries().items()]


def _renderers() -> Rows:
    """Renderers, none of which is imported."""
    from embodichain.lab.sim.drawing.renderer_register import RENDERERS

    return [{"name": name, "what": summary} for name, summary in RENDERERS.summaries().items()]


def _learners() -> Rows:
    """Learners; their configs are imported, the algorithms are not."""
    from embodichain.config.keys.learners import LEARNERS

    return [
        {"name": name, "algorithm": entry.builds, "demonstrations": entry.demonstrations}
        for name, entry in LEARNERS.items()
    ]


def _steps() -> Rows:
    """Steps of experts, with their parameters."""
    from embodichain.lab.gym.envs.managers.terms.registry import describe_term
    from embodichain.lab.gym.expert.step_register import STEPS

    return [
        {
            "name": name,
            "params": ", ".join(describe_term("step", step, name).params),
            "what": (inspect.getdoc(step) or "").partition("\n")[0],
        }
        for name, step in STEPS.items()
    ]
