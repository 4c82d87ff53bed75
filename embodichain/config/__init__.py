"""From YAML and overrides to one checked, frozen config: compose, validate, derive, freeze.

What a config means (scenes, terms, algorithms) lives below, in `lab`; this package reads its data
classes and its checks. Names are found on first use, so that importing the package costs nothing.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.config.composed import Composed, compose, from_hydra, list_options
    from embodichain.config.factory import make, make_env
    from embodichain.config.file_validation import validate_file
    from embodichain.config.frozen import dump_yaml, freeze, thaw
    from embodichain.config.locate import LocatedProblem
    from embodichain.config.overrides import relax
    from embodichain.config.resolved import Resolved, resolve, resolve_tree
    from embodichain.config.run_folder import adopt, claim, find_run, write_record
    from embodichain.config.search_path import user_configs
    from embodichain.config.validation import validate

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "composed": ["Composed", "compose", "from_hydra", "list_options"],
        "frozen": ["dump_yaml", "freeze", "thaw"],
        "factory": ["make", "make_env"],
        "overrides": ["relax"],
        "locate": ["LocatedProblem"],
        "resolved": ["Resolved", "resolve", "resolve_tree"],
        "run_folder": ["adopt", "claim", "find_run", "write_record"],
        "search_path": ["user_configs"],
        "validation": ["validate"],
        "file_validation": ["validate_file"],
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
