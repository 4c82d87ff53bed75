"""From YAML and overrides to one checked, frozen config: compose, validate, resolve, compile.

Scenes and terms are defined in `lab`; this package uses its data classes and checks. Names are
imported on first use, so that importing the package is cheap.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.config.checks.validation import validate
    from embodichain.config.composition.composed import (
        Composed,
        compose,
        from_hydra,
        list_options,
        relax,
    )
    from embodichain.config.composition.hydra_loader import user_configs
    from embodichain.config.environments.factory import make, make_batch, make_env
    from embodichain.config.file_validation import validate_file
    from embodichain.config.resolved import (
        Resolved,
        compile_scene_of,
        dump_yaml,
        freeze,
        resolve,
        resolve_tree,
        thaw,
        write_record,
    )
    from embodichain.config.run_folder import adopt, claim, find_run

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "composition.composed": ["Composed", "compose", "from_hydra", "list_options", "relax"],
        "environments.factory": ["make", "make_batch", "make_env"],
        "composition.hydra_loader": ["user_configs"],
        "resolved": [
            *("Resolved", "compile_scene_of", "dump_yaml", "freeze", "resolve"),
            *("resolve_tree", "thaw", "write_record"),
        ],
        "run_folder": ["adopt", "claim", "find_run"],
        "checks.validation": ["validate"],
        "file_validation": ["validate_file"],
    },
)

__all__ = [
    "Composed",
    "Resolved",
    "adopt",
    "claim",
    "compile_scene_of",
    "compose",
    "dump_yaml",
    "find_run",
    "freeze",
    "from_hydra",
    "list_options",
    "make",
    "make_batch",
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
