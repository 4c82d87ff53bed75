"""Modules that the package's own root adds to a registry below it.

Lower layers import no higher one; the root, `embodichain/__init__.py`, knows both and names them.
"""

from __future__ import annotations

__all__ = ["TERM_MODULES"]

TERM_MODULES: list[str] = []
"""Modules that are imported with the built-in terms: importing one registers its terms."""
