"""What Hydra, OmegaConf and the YAML parser raise, in one readable line with file and line."""

from __future__ import annotations

import re
from pathlib import Path

import yaml
from hydra.core.config_loader import ConfigLoader
from hydra.errors import HydraException, MissingConfigException

from embodichain.config.locate import COMMAND_LINE, LocatedProblem, display_path
from embodichain.config.search_path import folder_of_source
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["COMPOSING", "explain", "explain_yaml"]


_SHOWN_BY = {"task": "embodichain list tasks"}
PLUGINS = {("hydra/launcher", "joblib"), ("hydra/sweeper", "optuna")}
"""Options that the packages of the extra `sweep` bring."""

COMPOSING = (HydraException, yaml.YAMLError, UnicodeDecodeError, OSError)
"""What composing may raise because of the user's files."""


def explain(error: Exception, loader: ConfigLoader) -> list[LocatedProblem]:
    """Describe an error of composing.

    Args:
        error: One of `COMPOSING`.
        loader: Knows groups, options and places.
    """
    if isinstance(error, yaml.YAMLError):
        return [explain_yaml(error)]
    if isinstance(error, UnicodeDecodeError):
        return [LocatedProblem("", "not UTF-8 text", source=name) for name in _not_utf8(loader)]
    if isinstance(error, OSError) and not isinstance(error, HydraException):
        name = display_path(Path(str(error.filename)))
        return [LocatedProblem("", f"cannot be read: {error.strerror}", source=name)]
    unchosen = re.search(r"You must specify '([^']+)'", str(error))
    if unchosen:
        return [_unchosen(unchosen[1], loader)]
    if isinstance(error, MissingConfigException):
        return [_no_such_config(error, loader)]
    twice = re.search(r"Multiple values for (\S+)\.|(\S+) appears more than once", str(error))
    if twice:
        group = twice[1] or twice[2]
        message = f"an option is chosen already: write {group}=NAME, without +"
        return [LocatedProblem(group, message, source=COMMAND_LINE)]
    cause = error.__cause__ or error
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    key = next((line[9:].strip() for line in lines if line.startswith("full_key:")), "")
    text = lines[0] if lines else type(cause).__name__
    return [LocatedProblem(key, text, source=COMMAND_LINE)]


def explain_yaml(error: yaml.YAMLError, path: Path | None = None) -> LocatedProblem:
    """Describe malformed YAML with the place that the parser stopped at."""
    mark = getattr(error, "problem_mark", None)
    reason = getattr(error, "problem", None) or str(error)
    context = getattr(error, "context", None)
    where = "" if path is None else display_path(path)
    if mark is not None:
        name = where or (display_path(Path(mark.name)) if Path(mark.name).is_file() else mark.name)
        where = f"{name}:{mark.line + 1}"
    if reason.startswith("could not determine a constructor for the tag"):
        reason = f"tags are not used here, found {reason.split()[-1]}"
    detail = f"{reason} ({context})" if context else reason
    return LocatedProblem("", f"malformed YAML: {detail}", source=where)


def _unchosen(group: str, loader: ConfigLoader) -> LocatedProblem:
    options = listing(loader.get_group_options(group), shown_by=_SHOWN_BY.get(group, ""))
    message = f"missing value: choose one with {group}=NAME; there are: {options}"
    return LocatedProblem(group, message, source=COMMAND_LINE)


def _no_such_config(error: MissingConfigException, loader: ConfigLoader) -> LocatedProblem:
    name = error.missing_cfg_file or ""
    group, _, option = name.rpartition("/")
    asked = re.search(r"In '([^']+)'", str(error))
    place = f" (in the defaults list of '{asked[1]}')" if asked else ""
    if (group, option) in PLUGINS:
        message = f"{option!r}{place} needs packages: pip install 'embodichain[sweep]'"
        return LocatedProblem(group, message, source=COMMAND_LINE)
    options = list(error.options or loader.get_group_options(group))
    if not options:
        return LocatedProblem("", f"there is no config '{name}'{place}", source=COMMAND_LINE)
    there = listing(options, option, _SHOWN_BY.get(group, ""))
    message = f"unknown option {option!r}{place}; {group} is one of: {there}."
    return LocatedProblem(group, message, did_you_mean(option, options).strip(), COMMAND_LINE)


def _not_utf8(loader: ConfigLoader) -> list[str]:
    """The files of the search path that cannot be read as text: the error does not name its own."""
    folders = [folder_of_source(source.scheme(), source.path) for source in loader.get_sources()]
    return [
        display_path(path)
        for folder in folders
        if folder is not None
        for path in sorted(folder.rglob("*.yaml"))
        if not _is_utf8(path)
    ]


def _is_utf8(path: Path) -> bool:
    try:
        path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return False
    return True
