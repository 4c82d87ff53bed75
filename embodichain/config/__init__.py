"""From YAML and overrides to one checked, frozen config: compose, validate, derive, freeze.

What a config means (scenes, terms, algorithms) lives below, in `lab`; this package reads its data
classes and its checks. Names are found on first use, so that importing the package costs nothing.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.config.compose import Composed, compose, from_hydra, list_options
    from embodichain.config.freeze import dump_yaml, freeze, thaw
    from embodichain.config.make import make, make_env
    from embodichain.config.overrides import relax
    from embodichain.config.problems import LocatedProblem
    from embodichain.config.resolve import Resolved, resolve, resolve_tree
    from embodichain.config.run_folder import adopt, claim, find_run, write_record
    from embodichain.config.search_path import user_configs
    from embodichain.config.validate import validate
    from embodichain.config.validate_file import validate_file

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "compose": ["Composed", "compose", "from_hydra", "list_options"],
        "freeze": ["dump_yaml", "freeze", "thaw"],
        "make": ["make", "make_env"],
        "overrides": ["relax"],
        "problems": ["LocatedProblem"],
        "resolve": ["Resolved", "resolve", "resolve_tree"],
        "run_folder": ["adopt", "claim", "find_run", "write_record"],
        "search_path": ["user_configs"],
        "validate": ["validate"],
        "validate_file": ["validate_file"],
    },
)

__all__ = [
    "Composed",
    "LocatedProblem",
    "Resolved",
    "adopt",
    "claim",
    "compose",
    "dump_yaml",
    "find_run",
    "freeze",
    "from_hydra",
    "list_options",
    "make",
    "make_env",
    "relax",
    "resolve",
    "resolve_tree",
    "thaw",
    "user_configs",
    "validate",
    "validate_file",
    "write_record",
]
