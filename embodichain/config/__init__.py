"""From YAML and overrides to one checked, frozen config: compose, validate, derive, freeze.

What a config means (scenes, terms, algorithms) lives below, in `lab`; this package reads its data
classes and its checks. Names are found on first use, so that importing the package costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "compose": ["Composed", "compose", "from_hydra", "list_options"],
        "freeze": ["dump_yaml", "freeze", "thaw"],
        "make": ["make", "make_env"],
        "overrides": ["relax"],
        "problems": ["LocatedProblem"],
        "resolve": ["Resolved", "resolve", "resolve_tree"],
        "run_folder": ["RunFolder", "claim"],
        "search_path": ["user_configs"],
        "validate": ["validate", "validate_file"],
    },
)
