"""What Hydra, OmegaConf and the YAML parser raise, in one readable line with file and line."""

from __future__ import annotations

import re
from pathlib import Path

import yaml
from hydra.core.config_loader import ConfigLoader
from hydra.errors import HydraException, MissingConfigException

from embodichain.config.locate import display_path
from embodichain.config.problems import COMMAND_LINE, LocatedProblem
from embodichain.utils.suggest import did_you_mean

__all__ = ["explain", "explain_yaml"]


def explain(error: HydraException | yaml.YAMLError, loader: ConfigLoader) -> list[LocatedProblem]:
    """Describe an error of composing.

    Args:
        error: What was raised.
        loader: Knows groups, options and places.
    """
    if isinstance(error, yaml.YAMLError):
        return [explain_yaml(error)]
    unchosen = re.search(r"You must specify '([^']+)'", str(error))
    if unchosen:
        return [_unchosen(unchosen[1], loader)]
    if isinstance(error, MissingConfigException):
        return [_no_such_config(error, loader)]
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
    detail = f"{reason} ({context})" if context else reason
    return LocatedProblem("", f"malformed YAML: {detail}", source=where)


def _unchosen(group: str, loader: ConfigLoader) -> LocatedProblem:
    options = ", ".join(loader.get_group_options(group))
    message = f"missing value: choose one with {group}=NAME; there are: {options}"
    return LocatedProblem(group, message, source=COMMAND_LINE)


def _no_such_config(error: MissingConfigException, loader: ConfigLoader) -> LocatedProblem:
    name = error.missing_cfg_file or ""
    group, _, option = name.rpartition("/")
    asked = re.search(r"In '([^']+)'", str(error))
    place = f" (in the defaults list of '{asked[1]}')" if asked else ""
    options = list(error.options or loader.get_group_options(group))
    if not options:
        return LocatedProblem("", f"there is no config '{name}'{place}", source=COMMAND_LINE)
    message = f"unknown option {option!r}{place}; {group} is one of: {', '.join(options)}."
    return LocatedProblem(group, message, did_you_mean(option, options).strip(), COMMAND_LINE)
