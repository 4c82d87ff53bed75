"""Folders that keys of Hydra itself name: `hydra.run.dir`, `hydra.sweep.dir`, `hydra.sweep.subdir`.

They may refer to other keys; a reference that is not a name is refused before anything is made.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from omegaconf import DictConfig, ListConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from embodichain.config.composition.locate import COMMAND_LINE
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["check_subfolders", "folder_named", "numbers_jobs"]

_SUBFOLDER = "hydra.sweep.subdir"
_REFERENCE = re.compile(r"\$\{([^${}:]+)\}")


def folder_named(config: DictConfig, key: str) -> str:
    """Return the folder that a key of Hydra itself names.

    Args:
        config: A config with Hydra's own node.
        key: The key.

    Raises:
        ConfigError: It refers to a key that does not exist, or to a map or list.
    """
    for name in _REFERENCE.findall(_unresolved(config, key)):
        value = OmegaConf.select(config, name, throw_on_resolution_failure=False)
        if isinstance(value, DictConfig | ListConfig):
            kind = "map" if isinstance(value, DictConfig) else "list"
            message = f"${{{name}}} is a {kind}, and a folder's name is text"
            hint = ""
            if name in config.hydra.runtime.choices:  # a config group
                hint = f"The option's name is ${{hydra.runtime.choices.{name}}}."
            raise ConfigError([Problem(key, message, hint).at(COMMAND_LINE)])
    try:
        return str(OmegaConf.select(config, key, throw_on_missing=True))
    except OmegaConfBaseException as error:
        reason = str(error).splitlines()[0]
        raise ConfigError([Problem(key, reason, source=COMMAND_LINE)]) from error


def numbers_jobs(config: DictConfig) -> bool:
    """Whether the jobs of a sweep have their numbers as folders, which is the default."""
    return _unresolved(config, _SUBFOLDER) == "${hydra.job.num}"


def check_subfolders(jobs: Sequence[DictConfig]) -> None:
    """Check that each job of a sweep has a folder of its own.

    Args:
        jobs: The config of each job, with Hydra's own node.

    Raises:
        ConfigError: A folder cannot be named, or two jobs have the same.
    """
    first_jobs: dict[str, int] = {}
    for number, config in enumerate(jobs):
        with open_dict(config):  # as Hydra's launchers do
            config.hydra.job.num = number
            config.hydra.job.id = f"job_id_{number}"
        folder = folder_named(config, _SUBFOLDER)
        first_job = first_jobs.setdefault(folder, number)
        if first_job != number:
            message = f"jobs {first_job} and {number} have the same folder, {folder!r}"
            hint = "${hydra.job.num} and ${hydra.job.override_dirname} differ in each job."
            raise ConfigError([Problem(_SUBFOLDER, message, hint).at(COMMAND_LINE)])


def _unresolved(config: DictConfig, key: str) -> str:
    """The value of a key before its references are resolved."""
    section, _, name = key.rpartition(".")
    values = OmegaConf.to_container(OmegaConf.select(config, section), resolve=False)
    return str(values[name]) if isinstance(values, dict) else ""
