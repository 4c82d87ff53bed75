"""The `embodichain` command. No other package imports this one; `main` is its only name."""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.cli.app import main

__getattr__, __dir__, _ = lazy_loader.attach(__name__, submod_attrs={"app": ["main"]})

__all__ = ["main"]
