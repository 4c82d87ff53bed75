"""Term modules registered by the package's root, `embodichain/__init__.py`.

The root lists them here because lower layers may not import higher ones.
"""

from __future__ import annotations

__all__ = ["TERM_MODULES"]

TERM_MODULES: list[str] = []
"""Modules imported with the built-in terms; importing one registers its terms."""
