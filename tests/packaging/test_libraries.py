"""Libraries inside of `lab`: they are imported without the rest of it."""

import subprocess
import sys

import pytest

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]


@pytest.mark.parametrize("library", ["drawing", "engine.device"])
def test_a_library_is_imported_without_the_rest_of_lab(library: str) -> None:
    package = f"embodichain.lab.sim.{library}"
    code = f"""
import importlib, pkgutil, sys
package = importlib.import_module({package!r})
for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
    importlib.import_module(module.name)
print(*(name for name in sys.modules if name.startswith("embodichain.lab.")))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    parents = {"embodichain.lab.sim", "embodichain.lab.sim.engine"}
    assert package in loaded
    assert {n for n in loaded - parents if not n.startswith(package)} == set()
