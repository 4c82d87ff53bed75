"""`scripts/house.py` as a module."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

REPO = Path(__file__).parents[2]


def house() -> ModuleType:
    """Import the script, once."""
    if "house" not in sys.modules:
        spec = importlib.util.spec_from_file_location("house", REPO / "scripts" / "house.py")
        if spec is None or spec.loader is None:
            raise ImportError("scripts/house.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules["house"] = module
        spec.loader.exec_module(module)
    return sys.modules["house"]
