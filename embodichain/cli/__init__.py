"""The `embodichain` command. Nobody imports this package; `main` is its only name."""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.cli.dispatch import main

__getattr__, __dir__, _ = lazy_loader.attach(__name__, submod_attrs={"dispatch": ["main"]})

__all__ = ["main"]
