"""Prints constraints.txt: an exact pin for everything the installed `embodichain[dev]` needs.

Run it with the environment's own python (`make pins`) after changing a dependency. A package that
is installed but needed by nothing is left out; a needed one that is missing is an error.
"""

import importlib.metadata as metadata
import sys

from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

HEADER = """\
# Exact pins of everything `pip install -e .[dev]` needs: what the tests run with (`make pins`).
# torch has no local version here: both the CPU build and the one with CUDA are 'torch X.Y.Z'.
"""


def closure(root: Requirement) -> dict[str, str]:
    """Finds every distribution that `root` needs, without `root` itself.

    Args:
        root: The requirement to start from, with its extras.

    Returns:
        Canonical name to public version (no local part such as `+cpu`).

    Raises:
        importlib.metadata.PackageNotFoundError: If a needed distribution is not installed.
    """
    found: dict[str, str] = {}
    seen: set[tuple[str, str]] = set()
    todo = [root]
    while todo:
        requirement = todo.pop()
        name = canonicalize_name(requirement.name)
        found[name] = Version(metadata.version(name)).public
        for extra in {"", *requirement.extras}:
            if (name, extra) not in seen:
                seen.add((name, extra))
                todo += _needs(name, extra)
    del found[canonicalize_name(root.name)]
    return dict(sorted(found.items()))


def _needs(name: str, extra: str) -> list[Requirement]:
    """Lists what `name[extra]` asks for on this machine."""
    environment = {**default_environment(), "extra": extra}
    requirements = map(Requirement, metadata.requires(name) or [])
    return [r for r in requirements if r.marker is None or r.marker.evaluate(environment)]


if __name__ == "__main__":
    sys.stdout.write(HEADER)
    for name, version in closure(Requirement("embodichain[dev]")).items():
        sys.stdout.write(f"{name}=={version}\n")
