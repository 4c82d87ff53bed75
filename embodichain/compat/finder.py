"""The import hook for EmbodiChain's modules, and for its names missing from this package's modules.

It applies only to the modules of `names.upstream_modules`. A module of this package is loaded as
usual; only a name that it lacks is looked up in `names`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any

from embodichain.compat.names import available, find, upstream_modules, upstream_names

__all__ = ["install"]

_ROOT = "embodichain."


class _Completed(SourceFileLoader):
    """Loads a module of this package and adds the EmbodiChain names that it lacks."""

    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        complete(module)


class _Alias(Loader):
    """Creates a module that exists only in EmbodiChain, with its names."""

    def create_module(self, spec: ModuleSpec) -> None:
        """Return None, so that Python creates the module."""

    def exec_module(self, module: ModuleType) -> None:
        module.__doc__ = (
            f"EmbodiChain's `{module.__name__}`; docs/compatibility.md lists its names."
        )
        module.__dir__ = lambda: available(module.__name__)  # type: ignore[method-assign]
        complete(module)


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(_ROOT) or fullname not in upstream_modules():
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.origin is None:  # no such module, or a folder without Python
            below = f"{fullname}."
            package = any(name.startswith(below) for name in upstream_modules())
            alias = ModuleSpec(fullname, _Alias(), is_package=package)
            if spec is not None:
                alias.submodule_search_locations = spec.submodule_search_locations
            return alias
        if type(spec.loader) is SourceFileLoader and upstream_names(fullname):
            spec.loader = _Completed(fullname, spec.loader.path)
        return spec


def complete(module: ModuleType) -> None:
    """Look up EmbodiChain's names in a module that lacks them."""
    name_of, listed = module.__name__, upstream_names(module.__name__)
    own: Callable[[str], Any] | None = module.__dict__.get("__getattr__")

    def look_up(name: str) -> Any:
        if own is not None:
            try:
                return own(name)
            except AttributeError:
                if name not in listed:
                    raise
        if name in listed:
            return find(name_of, name)
        if name == "__all__" and module.__spec__ and isinstance(module.__spec__.loader, _Alias):
            return available(name_of)
        raise AttributeError(f"module {name_of!r} has no attribute {name!r}")

    module.__getattr__ = look_up  # type: ignore[method-assign]


def install() -> None:
    """Insert the finder first and complete the modules already loaded; once per process."""
    if any(isinstance(finder, _Finder) for finder in sys.meta_path):
        return
    for name, module in list(sys.modules.items()):
        if name == "embodichain" or name.startswith(_ROOT) and upstream_names(name):
            complete(module)
    sys.meta_path.insert(0, _Finder())
