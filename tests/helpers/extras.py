"""Tests of packages that are installed by an extra: skipped without them."""

import importlib.util

import pytest

__all__ = ["needs"]


def needs(*packages: str) -> pytest.MarkDecorator:
    """Return a mark that skips tests unless all of these packages are installed.

    Unlike `pytest.importorskip`, it imports nothing: each of the processes that share the tests
    collects all modules, and would spend seconds on packages that few of them use.
    """
    missing = [package for package in packages if importlib.util.find_spec(package) is None]
    return pytest.mark.skipif(bool(missing), reason=f"not installed: {', '.join(missing)}")
