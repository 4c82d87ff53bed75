"""Answers to names of Isaac Lab and mjlab that are not terms here: ``names_of_others.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources

import yaml

from embodichain.lab.gym.envs.managers.terms.other_projects import register_translations

__all__ = ["translations"]


def translations() -> Mapping[str, Mapping[str, str]]:
    """Project -> its name -> what to write here, or that there is nothing like it."""
    file = resources.files("embodichain.compat.terms").joinpath("names_of_others.yaml")
    return yaml.safe_load(file.read_text(encoding="utf-8"))


register_translations(translations)
