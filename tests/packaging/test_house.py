"""The source tree keeps what `scripts/house.py` measures: no circles, short walks."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from embodichain.lab.gym.envs import BaseEnv


@pytest.fixture(scope="module")
def house(repo: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("house", repo / "scripts" / "house.py")
    if spec is None or spec.loader is None:
        raise ImportError("scripts/house.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["house"] = module
    spec.loader.exec_module(module)
    return module


def test_no_modules_import_each_other(house: ModuleType) -> None:
    """Imports inside of functions and under `if TYPE_CHECKING` count."""
    assert house.circles() == []


def test_a_circle_would_be_found(house: ModuleType, tmp_path: Path) -> None:
    package = tmp_path / "circular"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "one.py").write_text("from circular import two\n")
    (package / "two.py").write_text("def late():\n    from circular import one\n")
    (package / "three.py").write_text("import circular.one\n")
    sys.path.insert(0, str(tmp_path))
    try:
        assert house.circles("circular") == [["circular.one", "circular.two"]]
    finally:
        sys.path.remove(str(tmp_path))


def test_private_names_stay_in_their_modules(house: ModuleType) -> None:
    assert house.private_accesses() == []


def test_the_environment_is_one_class_with_mixins() -> None:
    ours = [c for c in BaseEnv.__mro__[1:] if c.__module__.startswith("embodichain.")]
    assert {c.__name__: c.__bases__ for c in ours} == {c.__name__: (object,) for c in ours}
